"""Compiled loops: plain functions over arrays and floats, sequential, so that block size never changes a result bit.

Without numba every kernel runs as ordinary Python, correct and slow (`COMPILED`). Kernels do not check their input; the
classes that own the arrays do. A kernel and the functions it calls share a file, because numba's cache checks the date
of that file alone.
"""

from biodyn_core.kernels.alignment import interpolate
from biodyn_core.kernels.attitude import follow_attitude
from biodyn_core.kernels.chain import integrate_chain
from biodyn_core.kernels.compiling import COMPILED
from biodyn_core.kernels.exposure import (
    begin_loss,
    dose,
    dynamic_response,
    end_loss,
    find_losses,
    flag_suspect,
    head_injury,
    peak_forces,
    planar_dose,
    residual,
    set_steady_state,
)
from biodyn_core.kernels.guard import first_invalid
from biodyn_core.kernels.rails import find_rails
from biodyn_core.kernels.sensor import condition, filter_sections, level, regularise

__all__ = [
    "COMPILED",
    "begin_loss",
    "condition",
    "dose",
    "dynamic_response",
    "end_loss",
    "filter_sections",
    "find_losses",
    "find_rails",
    "first_invalid",
    "flag_suspect",
    "follow_attitude",
    "head_injury",
    "integrate_chain",
    "interpolate",
    "level",
    "peak_forces",
    "planar_dose",
    "regularise",
    "residual",
    "set_steady_state",
]
