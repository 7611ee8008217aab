"""Imports recordings of Blue Trident sensors, exported by Capture.U or Nexus, to a bag; without ROS.

`import_blue_trident` is the entry point. Files are read in blocks.
"""

from biodyn_ros.blue_trident.importing import MADE_BY, ImportOptions, import_blue_trident
from biodyn_ros.blue_trident.outcome import document_of, text_of

__all__ = ["MADE_BY", "ImportOptions", "document_of", "import_blue_trident", "text_of"]
