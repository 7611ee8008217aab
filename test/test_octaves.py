"""Mean squares by octave: sines fall into their band, the sum is the mean square, weighting is the standard's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from biodyn_core.signals.octaves import BAND_NAMES, EDGES_HZ, N_BANDS, TAPER, octave_squares
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
    assert found[band, 0] > 0.9 * found[:, 0].sum()


@pytest.mark.parametrize("count", [1129, 1024, 500])
def test_the_sum_is_the_mean_square_under_the_taper(count: int) -> None:
    """Parseval: exact for any signal; for noise it is the mean square in the mean."""
    values = 0.7 * np.random.default_rng(3).standard_normal((count, 400))
    taper = signal.windows.tukey(count, TAPER)[:, None]
    expected = np.mean((taper * values) ** 2, axis=0) / np.mean(taper**2)
    found = octave_squares(values, RATE_HZ).sum(axis=0)
    np.testing.assert_allclose(found, expected, rtol=1e-12)
    assert found.mean() == pytest.approx(0.49, rel=0.01)


def test_slow_motion_leaks_far_less_into_the_upper_bands_than_without_a_taper() -> None:
    values = sine(1.3)
    found = octave_squares(values[:, None], RATE_HZ)[:, 0]
    plain = np.abs(np.fft.rfft(values)) ** 2
    upper = np.fft.rfftfreq(values.size, 1.0 / RATE_HZ) >= EDGES_HZ[3]
    assert found[4:].sum() / found.sum() < 0.01 * plain[upper].sum() / plain.sum()


def test_weighted_squares_follow_the_curve_of_the_standard() -> None:
    for frequency_hz in (1.0, 6.0, 24.0):
        values = sine(frequency_hz)[:, None]
        gain = np.abs(analog_response("Wk", frequency_hz)).item()
        weighted = octave_squares(values, RATE_HZ, "Wk").sum() / octave_squares(values, RATE_HZ).sum()
        assert weighted == pytest.approx(gain**2, rel=0.08)


def test_bands_have_names() -> None:
    assert len(BAND_NAMES) == N_BANDS == len(EDGES_HZ) + 1
    assert BAND_NAMES[0] == "below_2_hz" and BAND_NAMES[2] == "4_to_8_hz" and BAND_NAMES[-1] == "above_32_hz"
