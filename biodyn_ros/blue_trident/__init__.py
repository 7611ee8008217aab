"""Recordings of Blue Trident sensors, as Capture.U and Nexus export them, to a bag; without ROS.

`import_blue_trident` is the whole way. A file is read in blocks and never held whole.
"""

from biodyn_ros.blue_trident.importing import MADE_BY, ImportOptions, import_blue_trident
from biodyn_ros.blue_trident.outcome import text_of

__all__ = ["MADE_BY", "ImportOptions", "import_blue_trident", "text_of"]
