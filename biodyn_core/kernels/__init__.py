"""The compiled loops: small plain functions over arrays and floats, sequential so that block cuts never change a bit.

Without numba every kernel runs as ordinary Python, correct and slow (`COMPILED`). No kernel checks its input; the
classes that own the arrays do. A kernel and those it calls share a file: numba's cache looks at that one's date alone.
"""

from biodyn_core.kernels.alignment import interpolate
from biodyn_core.kernels.attitude import follow_attitude
from biodyn_core.kernels.chain import integrate_chain
from biodyn_core.kernels.compiling import COMPILED
from biodyn_core.kernels.exposure import dose, dynamic_response, head_injury, planar_dose, residual, settle
from biodyn_core.kernels.guard import first_lost
from biodyn_core.kernels.rails import find_rails
from biodyn_core.kernels.sensor import condition, filter_sections, level, regularise

__all__ = [
    "COMPILED",
    "condition",
    "dose",
    "dynamic_response",
    "filter_sections",
    "find_rails",
    "first_lost",
    "follow_attitude",
    "head_injury",
    "integrate_chain",
    "interpolate",
    "level",
    "planar_dose",
    "regularise",
    "residual",
    "settle",
]
