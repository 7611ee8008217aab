"""Spectra and waterfalls of streams: averages of the whole record for any cut, in constant memory."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal
from streams import held_bytes

from biodyn_core.base.segments import MEASURED_SEGMENTS
from biodyn_core.pipeline.frames import MeasuredFrames
from biodyn_core.signals.response import SpectraMeter, SpectrumSettings, cross_spectra
from biodyn_core.signals.waterfall import BIN_NS, BINS, WaterfallMeter
from biodyn_ros.replay.spectra import ReplaySpectra

RATE_HZ = 200.0
START_NS = 1_767_225_600 * 10**9
SHORT = SpectrumSettings(segment_s=0.5, lowest_hz=4.0, highest_hz=50.0)


def stamps(samples: int, rate_hz: float = RATE_HZ) -> np.ndarray:
    return START_NS + np.rint(np.arange(samples) * 1e9 / rate_hz).astype(np.int64)


def pieces(length: int, cuts: list[int]) -> list[slice]:
    edges = [0, *sorted({cut for cut in cuts if 0 < cut < length}), length]
    return [slice(a, b) for a, b in pairwise(edges)]


# --- averages --------------------------------------------------------------------------------------------------------


def test_the_averages_are_scipys() -> None:
    rng = np.random.default_rng(0)
    x = rng.standard_normal(4000)
    y = signal.lfilter([0.3, 0.5], [1.0, -0.4], x) + 0.2 * rng.standard_normal(4000)
    meter = SpectraMeter(RATE_HZ, 1, SHORT)
    for piece in pieces(4000, list(range(0, 4000, 73))):
        meter.push(x[piece], y[piece, None])
    found = meter.spectra()
    how = {"fs": RATE_HZ, "window": "hann", "nperseg": 100, "noverlap": 50, "detrend": "constant"}
    frequency, cross = signal.csd(x, y, **how)
    lines = (frequency >= 4.0) & (frequency <= 50.0)
    np.testing.assert_allclose(found.cross[:, 0], cross[lines], rtol=1e-12)
    np.testing.assert_allclose(found.input_psd[:, 0], signal.welch(x, **how)[1][lines], rtol=1e-12)
    np.testing.assert_allclose(found.coherence[:, 0], signal.coherence(x, y, **how)[1][lines], rtol=1e-9)


def slow_starts(usable: np.ndarray, size: int, step: int) -> list[int]:
    """Sample by sample: a segment is whole once so many usable samples lie behind each other."""
    starts, run = [], 0
    for at, good in enumerate(usable):
        run = run + 1 if good else 0
        if run >= size and (run - size) % step == 0:
            starts.append(at - size + 1)
    return starts


@settings(max_examples=40)
@given(st.lists(st.integers(0, 1200), max_size=12), st.lists(st.integers(0, 1199), max_size=8), st.integers(0, 9))
def test_any_cut_and_any_mask_gives_the_segments_of_the_whole(cuts: list[int], masked: list[int], seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, y = rng.standard_normal(1200), rng.standard_normal((1200, 2))
    y[masked, 0] = np.nan
    x[masked[:1]] = np.nan
    meter = SpectraMeter(RATE_HZ, 2, SHORT)
    for piece in pieces(1200, cuts):
        meter.push(x[piece], y[piece])
    starts = [slow_starts(np.isfinite(x) & np.isfinite(column), 100, 50) for column in y.T]
    if not any(starts):
        return
    found = meter.spectra()
    assert found.segments.tolist() == [len(each) for each in starts]
    window = signal.get_window("hann", 100)
    for m, each in enumerate(starts):
        parts = [y[start : start + 100, m] for start in each]
        powers = [np.abs(np.fft.rfft((part - part.mean()) * window)) ** 2 for part in parts]
        if powers:
            expected = np.mean(powers, axis=0)[2:26] * 2.0 / (RATE_HZ * (window**2).sum())
            np.testing.assert_allclose(found.output_psd[:, m], expected, rtol=1e-9)


def test_no_segment_reaches_across_a_break() -> None:
    x = np.random.default_rng(1).standard_normal(150)
    meter = SpectraMeter(RATE_HZ, 1, SHORT)
    meter.push(x, x[:, None])
    meter.part()
    meter.push(x, x[:, None])
    assert meter.spectra().segments.tolist() == [4]  # two in each, five had there been no break
    assert cross_spectra([(x, x[:, None])] * 2, RATE_HZ, SHORT).segments.tolist() == [4]


# --- waterfall -------------------------------------------------------------------------------------------------------


def test_a_tone_has_its_power_at_its_time_and_frequency() -> None:
    seconds = np.arange(2000) / RATE_HZ
    tone = 3.0 * np.sin(2 * np.pi * np.where(seconds < 6.0, 12.0, 31.0) * seconds)
    meter = WaterfallMeter(RATE_HZ, 2)
    meter.push(stamps(2000), np.column_stack([tone, np.where(seconds < 2.0, np.nan, tone)]))
    found = meter.waterfall()
    assert found.width_ns == BIN_NS and found.begins_ns.tolist() == [START_NS + n * BIN_NS for n in range(10)]
    for row in range(10):
        loudest = found.frequency_hz[found.density[row, :, 0].argmax()]
        assert loudest == (12.0 if row < 6 else 31.0)
        assert found.density[row, :, 0].sum() == pytest.approx(4.5, rel=1e-6)  # half the amplitude squared
    assert np.isnan(found.density[:2, :, 1]).all() and np.isfinite(found.density[2:, :, 1]).all()


def test_a_tone_is_drawn_within_half_a_second_of_its_time() -> None:
    """At 1129.3 Hz a periodogram is a little shorter than a bin, so its first sample soon lies before the bin."""
    rate_hz, count = 1129.3, 45_000
    seconds = np.arange(count) / rate_hz
    tone = np.where((seconds >= 20.0) & (seconds < 30.0), np.sin(2 * np.pi * 12.0 * seconds), 0.0)
    meter = WaterfallMeter(rate_hz, 1)
    meter.push(stamps(count, rate_hz), tone[:, None])
    found = meter.waterfall()
    begins_s = (found.begins_ns - START_NS) / 1e9
    power = found.density[:, :, 0].sum(axis=1)
    assert begins_s[power > 0.25 * power.max()].tolist() == [20.0 + n for n in range(10)]


def test_an_hour_of_waterfall_has_as_many_bins_as_a_page_shows_and_their_means() -> None:
    rate_hz, meter = 50.0, WaterfallMeter(50.0, 1)
    loud = np.repeat(np.arange(3600), 50)
    values = loud * np.sin(2 * np.pi * 10.0 * np.arange(180_000) / rate_hz)
    most, when = 0, stamps(180_000, rate_hz)
    for piece in pieces(180_000, list(range(0, 180_000, 777))):
        meter.push(when[piece], values[piece, None])
        most = max(most, meter.stored)
    assert most < BINS + 777 + 50
    found = meter.waterfall()
    assert found.width_ns == 16 * BIN_NS and found.begins_ns.size in (225, 226)
    for row, begin in enumerate(found.begins_ns):
        seconds = np.arange(max(0, (begin - START_NS) // BIN_NS), min(3600, (begin - START_NS) // BIN_NS + 16))
        assert found.density[row].sum() == pytest.approx(np.mean(seconds**2 / 2.0), rel=1e-6)


def test_stamps_far_apart_do_not_fill_the_memory() -> None:
    meter = WaterfallMeter(RATE_HZ, 1)
    for jump_ns in (0, 400 * 86_400 * 10**9, 10**9):
        meter.part()
        meter.push(stamps(600) + jump_ns, np.ones((600, 1)))
    found = meter.waterfall()
    assert found.begins_ns.size == 2
    assert (found.begins_ns[-1] - found.begins_ns[0]) // found.width_ns < BINS


# --- replay ----------------------------------------------------------------------------------------------------------

GAIN = {"pelvis": 2.0, "upper_torso": 0.25, "neck": 1.0, "head": 3.0}


def frames(samples: int = 4000, rate_hz: float = RATE_HZ) -> MeasuredFrames:
    """White noise with a gain for every segment; the prediction is half of it; no sensor on the lower torso."""
    seat = np.random.default_rng(3).standard_normal(samples)
    measured = np.column_stack([GAIN.get(name, np.nan) * seat for name in MEASURED_SEGMENTS])
    return MeasuredFrames(stamps(samples, rate_hz), np.column_stack([seat, measured]), -0.5 * measured)


def fed(whole: MeasuredFrames, cuts: list[int]) -> ReplaySpectra:
    found = ReplaySpectra()
    for piece in pieces(whole.stamps_ns.size, cuts):
        found.add(MeasuredFrames(*(part[piece] for part in whole)))
    return found


def test_a_replay_finds_the_injected_gains() -> None:
    document = fed(frames(), [70, 71, 2500]).spectra()
    assert document is not None
    for name, gain in GAIN.items():
        of = document["transmissibility"][name]
        np.testing.assert_allclose(of["measured"]["magnitude"], gain, rtol=1e-5)
        np.testing.assert_allclose(of["predicted"]["magnitude"], 0.5 * gain, rtol=1e-5)
        np.testing.assert_allclose(of["measured"]["coherence"], 1.0, rtol=1e-5)
        power = document["power_spectral_density"][name]
        ratio = np.array(power["measured"]["amplitude_mps2"]) / np.array(power["predicted"]["amplitude_mps2"])
        np.testing.assert_allclose(ratio, 2.0, rtol=1e-5)
    assert document["transmissibility"]["lower_torso"] == {"measured": None, "predicted": None, "linear": None}
    assert document["power_spectral_density"]["lower_torso"] == {}
    assert "central_torso" not in document["transmissibility"].keys() | document["power_spectral_density"].keys()


@settings(max_examples=15)
@given(st.lists(st.integers(1, 3999), max_size=40))
def test_any_cut_of_a_replay_gives_the_same(cuts: list[int]) -> None:
    whole = frames()
    broken = MeasuredFrames(np.where(np.arange(4000) < 1900, whole.stamps_ns, whole.stamps_ns + 10**9), *whole[1:])
    once, cut = fed(broken, []), fed(broken, cuts)
    assert once.spectra() == cut.spectra()
    found, expected = cut.waterfall(), once.waterfall()
    assert found is not None and expected is not None
    np.testing.assert_array_equal(found.density, expected.density)
    np.testing.assert_array_equal(found.begins_ns, expected.begins_ns)


def test_memory_of_a_replay_does_not_grow_with_the_record() -> None:
    found, sizes = ReplaySpectra(), []
    block = frames(400)
    for number in range(1000):
        found.add(MeasuredFrames(block.stamps_ns + number * 2 * 10**9, *block[1:]))
        if number % 10 == 0:
            sizes.append(held_bytes(found))
    assert max(sizes) < 1_600_000 and max(sizes[30:]) < 1.05 * max(sizes[:30])


@pytest.mark.parametrize("samples", [0, 1, 2, 150])
def test_too_short_a_record_has_no_spectrum(samples: int) -> None:
    found = fed(frames(samples), [])
    assert found.spectra() is None and found.waterfall() is None


@pytest.mark.parametrize("quantum_ns", [100_000, 1_000_000, 2_000_000, 5_000_000])
def test_quantised_stamps_do_not_shift_frequencies(quantum_ns: int) -> None:
    """By their median step 1129.3 Hz are 1000 with stamps in milliseconds, and a resonance at 20 Hz is at 17.7."""
    rate_hz = 1129.3
    whole = frames(20_000, rate_hz)
    tone = whole.accel_mps2 + 5.0 * np.sin(2.0 * np.pi * 20.0 * np.arange(20_000) / rate_hz)[:, None]
    stamps_ns = whole.stamps_ns // quantum_ns * quantum_ns
    stamps_ns[12_000:] += 10**9  # a break
    document = fed(MeasuredFrames(stamps_ns, tone, whole.residual_mps2), [70, 71, 2500]).spectra()
    assert document is not None
    power = document["power_spectral_density"]["pelvis"]["measured"]["amplitude_mps2"]
    assert document["spectra"]["frequency_hz"][int(np.argmax(power))] == pytest.approx(20.0, rel=4e-3)


def test_a_slow_sensor_has_spectra_up_to_its_nyquist_frequency() -> None:
    document = fed(frames(2000, 50.0), []).spectra()
    assert document is not None and 22.0 < document["spectra"]["frequency_hz"][-1] <= 22.5
