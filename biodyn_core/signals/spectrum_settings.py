"""Settings of spectra."""

from __future__ import annotations

from dataclasses import dataclass

from biodyn_core.base.errors import InputError
from biodyn_core.base.settings import check_settings, setting


@dataclass(frozen=True)
class SpectrumSettings:
    """Welch's averaged segments, each without its mean, and the range of frequencies."""

    window: str = setting("hann", "window of a segment, by SciPy's name")
    segment_s: float = setting(2.0, "length of a segment, whose inverse is the step in frequency", "s", 0.25, 1000.0)
    overlap: float = setting(0.5, "share of a segment that the next one has too", "", 0.0, 0.9)
    lowest_hz: float = setting(1.0, "lowest frequency answered, at least two steps", "Hz", 0.002, 99.0)
    highest_hz: float = setting(50.0, "highest frequency answered", "Hz", 1.0, 100.0)

    def __post_init__(self) -> None:
        check_settings(self)
        import scipy  # the help of commands has no need of it

        try:
            scipy.signal.get_window(self.window, 16)
        except ValueError:
            raise InputError(f"window {self.window!r} is unknown to SciPy, or needs a parameter: try hann") from None
        if self.lowest_hz * self.segment_s < 2.0 * (1.0 - 1e-9):
            raise InputError(f"lowest_hz is {self.lowest_hz:g}, below two steps of {1.0 / self.segment_s:g} Hz")
        if self.highest_hz <= self.lowest_hz:
            raise InputError(f"highest_hz is {self.highest_hz:g}, expected more than lowest_hz {self.lowest_hz:g}")
