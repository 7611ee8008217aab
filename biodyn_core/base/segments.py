"""The six body segments of the model and its six sensors: names, order and constants.

Source: Zaman et al., 3.1 (segments, inferior to superior) and 5.2 (instrumentation).
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

SEGMENTS: Final = ("pelvis", "lower_torso", "central_torso", "upper_torso", "neck", "head")
SEAT: Final = "seat"
HEAD: Final = "head"
SENSORS: Final = (SEAT, "pelvis", "lower_torso", "upper_torso", "neck", HEAD)

CENTRAL: Final = SEGMENTS.index("central_torso")
"""The segment without a sensor."""

N_SEGMENTS: Final = len(SEGMENTS)
N_SENSORS: Final = len(SENSORS)

MEASURED_SEGMENTS: Final = SENSORS[1:]
"""The segments that carry a sensor: all but the central torso."""

MEASURED_SEGMENT_INDEX: Final[NDArray[np.intp]] = np.array([SEGMENTS.index(name) for name in MEASURED_SEGMENTS])
"""Index of each measured segment in `SEGMENTS`, shape (5,)."""

MASS_FRACTION: Final = np.array([0.099, 0.117, 0.162, 0.126, 0.018, 0.059])
"""Segment mass per body mass, gamma of Eq. 5, shape (6,)."""

STIFFENING_SHAPE_PER_M: Final = np.array([30.0, 25.0, 20.0, 15.0, 8.0, 4.0])
"""Nominal strain stiffening, alpha-bar of Eq. 16, shape (6,), 1/m.

The paper does not print it: it is alpha_nl over nl_scale in every column of Tables 2 and 3.
"""

STANDARD_GRAVITY_MPS2: Final = 9.80665
