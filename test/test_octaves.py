"""Mean squares by octave: sines fall into their band, the sum is the mean square, weighting is the standard's."""

from __future__ import annotations

import numpy as np
import pytest

from biodyn_core.signals.octaves import BAND_NAMES, EDGES_HZ, N_BANDS, octave_squares
from biodyn_core.signals.weighting import analog_response

RATE_HZ = 1129.0


def sine(frequency_hz: float, rms: float = 1.0, count: int = 1129) -> np.ndarray:
    return rms * np.sqrt(2.0) * np.sin(2.0 * np.pi * frequency_hz * np.arange(count) / RATE_HZ + 0.3)


@pytest.mark.parametrize(
    ("frequency_hz", "band"), [(1.0, 0), (3.0, 1), (6.0, 2), (11.0, 3), (23.0, 4), (50.0, 5), (300.0, 5)]
)
def test_a_sine_is_in_its_band(frequency_hz: float, band: int) -> None:
    found = octave_squares(np.column_stack([sine(frequency_hz, 2.0), np.zeros(1129)]), RATE_HZ)
    assert found.shape == (N_BANDS, 2) and found[:, 1].max() == 0.0
    assert found[band, 0] == pytest.approx(4.0, rel=0.12)
    assert np.delete(found[:, 0], band).sum() < 0.1 * 4.0


@pytest.mark.parametrize("count", [1129, 1024, 500])
def test_the_sum_is_the_mean_square_of_noise(count: int) -> None:
    rng = np.random.default_rng(3)
    values = 0.7 * rng.standard_normal((count, 400))
    assert octave_squares(values, RATE_HZ).sum(axis=0).mean() == pytest.approx(0.49, rel=0.01)


def test_slow_motion_does_not_leak_into_the_upper_bands() -> None:
    found = octave_squares(sine(1.3)[:, None], RATE_HZ)[:, 0]
    assert found[3:].sum() < 1e-3 * found.sum()


def test_weighted_squares_follow_the_curve_of_the_standard() -> None:
    for frequency_hz in (1.0, 6.0, 24.0):
        values = sine(frequency_hz)[:, None]
        gain = np.abs(analog_response("Wk", frequency_hz)).item()
        weighted = octave_squares(values, RATE_HZ, "Wk").sum() / octave_squares(values, RATE_HZ).sum()
        assert weighted == pytest.approx(gain**2, rel=0.08)


def test_bands_have_names() -> None:
    assert len(BAND_NAMES) == N_BANDS == len(EDGES_HZ) + 1
    assert BAND_NAMES[0] == "below_2_hz" and BAND_NAMES[2] == "4_to_8_hz" and BAND_NAMES[-1] == "above_32_hz"
