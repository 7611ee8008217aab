"""Settings of synthesis: load cases, and errors of synthetic IMUs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from biodyn_core.base.sampling_rate import MAX_RATE_HZ, MIN_RATE_HZ
from biodyn_core.base.settings import check_settings, setting

NATIVE_RATE_HZ: Final = 1129.3
"""Blue Trident, low-g channel (Zaman et al., 5.2)."""

CASES: Final = ("road", "pothole", "rail")
"""The paper's load cases (5.3)."""

CASE_S: Final = 10.0
"""Length of a load case, if none is given."""


@dataclass(frozen=True)
class SensorSettings:
    """Errors of the synthetic IMUs."""

    rate_hz: float = setting(NATIVE_RATE_HZ, "sampling rate", "Hz", MIN_RATE_HZ, MAX_RATE_HZ)
    tilt_deg: float = setting(8.0, "mounting tilt, rms per axis", "deg", 0.0, 60.0)
    noise_mps2: float = setting(0.05, "white noise of the accelerometer, rms", "m/s^2", 0.0, 5.0)
    bias_mps2: float = setting(0.05, "constant bias of the accelerometer, rms per axis", "m/s^2", 0.0, 2.0)
    gyro_noise_radps: float = setting(0.002, "white noise of the gyroscope, rms", "rad/s", 0.0, 1.0)
    range_g: float = setting(16.0, "range of the 16-bit accelerometer, either way", "g", 1.0, 400.0)
    clock_offset_ms: float = setting(0.2, "constant clock offset, rms", "ms", 0.0, 50.0)
    clock_drift_ppm: float = setting(20.0, "clock drift, rms", "ppm", 0.0, 1000.0)
    jitter_ms: float = setting(0.02, "white jitter of the stamps, rms", "ms", 0.0, 0.2)

    def __post_init__(self) -> None:
        check_settings(self)
