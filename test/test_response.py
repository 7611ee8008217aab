"""Spectra against SciPy, known filters and textbook errors; the driving point against the chain's algebra."""

from __future__ import annotations

import dataclasses

import naive
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import integrate, signal

from biodyn_core import kernels
from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import SEGMENTS
from biodyn_core.body.model import Chain, Response
from biodyn_core.body.subject import Subject, load_subject
from biodyn_core.signals.response import CrossSpectra, SpectrumSettings, common_rate_hz, cross_spectra, peak
from biodyn_core.validation.driving_point import driving_point, linear_driving_point
from biodyn_ros.base.resources import subject_file

RATE_HZ = 500.0
HEAD = SEGMENTS.index("head")
FINE = SpectrumSettings(segment_s=20.0, lowest_hz=0.5, highest_hz=40.0)


def linear(name: str = "subject_1") -> Subject:
    """A subject of the paper without strain stiffening."""
    subject = load_subject(subject_file(name))
    return dataclasses.replace(subject, parameters=dataclasses.replace(subject.parameters, stiffening_scale=0.0))


def noise(seconds: float, seed: int, rate_hz: float = RATE_HZ) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(round(seconds * rate_hz))


def simulated(subject: Subject, seconds: float, rate_hz: float = 1000.0, lowest_hz: float = 0.02) -> Response:
    """The answer to noise between `lowest_hz` and 80 Hz, 1 m/s^2 rms."""
    sos = signal.butter(2, [lowest_hz, 80.0], "bandpass", fs=rate_hz, output="sos")
    seat = signal.sosfilt(sos, noise(seconds, 7, rate_hz))
    return Chain.of(subject).simulate(seat / seat.std(), rate_hz)


# --- Welch -----------------------------------------------------------------------------------------------------------


@settings(max_examples=30)
@given(
    segment_s=st.sampled_from([1.0, 2.0, 3.3]),
    overlap=st.floats(0.0, 0.9),
    window=st.sampled_from(["hann", "hamming", "boxcar", "blackman"]),
    seed=st.integers(0, 99),
)
def test_without_masks_it_is_scipys(segment_s, overlap, window, seed):
    x, y = noise(12.0, seed), np.cumsum(noise(12.0, seed + 1)) + noise(12.0, seed)
    how = SpectrumSettings(window, segment_s, overlap, lowest_hz=2.0, highest_hz=60.0)
    found = cross_spectra([(x, y[:, None])], RATE_HZ, how)
    size = round(segment_s * RATE_HZ)
    how = {"fs": RATE_HZ, "window": window, "nperseg": size, "noverlap": int(overlap * size)}
    frequency, cross = signal.csd(x, y, **how)
    band = (frequency > 1.999) & (frequency < 60.001)
    np.testing.assert_allclose(found.frequency_hz, frequency[band])
    np.testing.assert_allclose(found.cross[:, 0], cross[band], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(found.input_psd[:, 0], signal.welch(x, **how)[1][band], rtol=1e-9)
    np.testing.assert_allclose(found.output_psd[:, 0], signal.welch(y, **how)[1][band], rtol=1e-9)
    np.testing.assert_allclose(found.coherence[:, 0], signal.coherence(x, y, **how)[1][band], rtol=1e-9)


def test_a_sine_shows_its_amplitude_in_a_line():
    time = np.arange(round(20 * RATE_HZ)) / RATE_HZ
    found = cross_spectra([(noise(20.0, 1), 3.0 * np.sin(2.0 * np.pi * 8.0 * time)[:, None])], RATE_HZ)
    line = np.argmin(abs(found.frequency_hz - 8.0))
    assert np.sqrt(2.0 * found.output_psd[line, 0] * found.bandwidth_hz) == pytest.approx(3.0, rel=1e-6)
    assert found.bandwidth_hz == pytest.approx(1.5 * 0.5)  # Hann: 1.5 lines


def known_filter() -> tuple[np.ndarray, np.ndarray]:
    """A resonance at 8 Hz, damped by 20 %, as numerator and denominator."""
    omega = 2.0 * np.pi * 8.0
    return signal.bilinear([0.4 * omega, omega**2], [1.0, 0.4 * omega, omega**2], RATE_HZ)


def noisy_answer(seconds: float, seed: int, noise_rms: float) -> tuple[CrossSpectra, np.ndarray, np.ndarray]:
    """(H1 of a known filter with noise on its answer, the filter's response, the coherence by formula)."""
    x, extra = noise(seconds, seed), noise_rms * noise(seconds, seed + 1000)
    y = signal.lfilter(*known_filter(), x) + extra
    found = cross_spectra([(x, y[:, None])], RATE_HZ)
    truth = signal.freqz(*known_filter(), worN=found.frequency_hz, fs=RATE_HZ)[1]
    return found, truth, np.abs(truth) ** 2 / (np.abs(truth) ** 2 + noise_rms**2)


def test_a_known_filter_is_found_within_its_statistical_error():
    errors, phases, reported = [], [], []
    for seed in range(40):
        found, truth, coherence = noisy_answer(30.0, seed, 0.5)
        errors.append(np.abs(found.h1[:, 0]) / np.abs(truth) - 1.0)
        phases.append(np.radians(found.phase_deg[:, 0]) - np.angle(truth))
        reported.append(found.relative_error[:, 0])
    theory = np.sqrt((1.0 - coherence) / (2.0 * found.averages[0] * coherence))
    tells = theory < 0.2  # the formula is for small errors
    assert tells.sum() > 20
    assert np.median(np.median(reported, axis=0)[tells] / theory[tells]) == pytest.approx(1.0, abs=0.1)
    for seen in (errors, phases):
        # 40 draws give an rms within 11 % at one frequency, and the median over frequencies within less.
        assert np.median(np.sqrt(np.mean(np.square(seen), axis=0))[tells] / theory[tells]) == pytest.approx(
            1.0, abs=0.1
        )
    # No bias but a leak into the neighbours of the resonance, 3 %, beyond four standard errors of the mean.
    assert (np.abs(np.mean(errors, axis=0)) < 0.03 + 4.0 * theory / np.sqrt(40))[tells].all()


def test_coherence_falls_with_noise_by_the_formula():
    found, _, coherence = noisy_answer(2000.0, 3, 0.5)
    np.testing.assert_allclose(found.coherence[:, 0], coherence, atol=0.03)
    assert coherence.max() > 0.95
    assert coherence.min() < 0.05


def test_unrelated_signals_exceed_the_chance_coherence_one_time_in_twenty():
    for seconds in (5.0, 12.0, 24.0):
        above = []
        for seed in range(60):
            found = cross_spectra([(noise(seconds, seed), noise(seconds, seed + 500)[:, None])], RATE_HZ)
            above.append(found.coherence[::3, 0] > found.chance_coherence[0])  # Hann's neighbours are not independent
        assert np.mean(above) == pytest.approx(0.05, abs=0.02)


@pytest.mark.parametrize("seconds", [6.0, 12.0, 40.0])
def test_one_shock_is_one_average_in_a_record_of_any_length(seconds):
    """Wherever it lies in the overlapping segments. Unrelated signals that share its time are not called coherent."""
    time_s = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    for seed, at_s in enumerate(np.linspace(2.0, seconds - 2.0, 7)):
        burst = np.exp(-0.5 * ((time_s - at_s) / 0.15) ** 2) + 0.01
        x, y = (noise(seconds, seed + more) * burst for more in (0, 500))
        found = cross_spectra([(x, y[:, None])], RATE_HZ)
        assert found.averages[0] < 1.3
        assert np.mean(found.coherence[:, 0] > found.chance_coherence[0]) < 0.1
        # A response without noise is known from one shock too.
        assert found.is_linear(0.5).any()


def test_shocks_of_the_input_beside_even_noise_keep_the_averages():
    """Only where both are strong at once does the number of averages fall."""
    time_s = np.arange(round(20.0 * RATE_HZ)) / RATE_HZ
    burst = np.exp(-0.5 * ((time_s - 10.0) / 0.15) ** 2)
    even = cross_spectra([(noise(20.0, 1), noise(20.0, 2)[:, None])], RATE_HZ)
    found = cross_spectra([(noise(20.0, 1) * burst, noise(20.0, 2)[:, None])], RATE_HZ)
    assert found.averages[0] > 0.5 * even.averages[0] > 5.0


def test_the_mean_coherence_of_unrelated_signals_exceeds_its_chance_one_time_in_twenty():
    weights, above = {}, {"even": [], "falling": []}
    for seed in range(150):
        found = cross_spectra([(noise(12.0, seed), noise(12.0, seed + 500)[:, None])], RATE_HZ)
        for name, falls in (("even", 0.0), ("falling", 0.15)):
            weights[name] = np.exp(-falls * np.arange(found.frequency_hz.size))[:, None]
            weights[name] /= weights[name].sum()
            mean = (found.coherence * weights[name]).sum(axis=0)
            above[name].append(mean[0] > found.chance_of_mean(weights[name])[0])
    for name, each in above.items():
        assert 0.0 < np.mean(each) < 0.10, name  # 0.05 within three deviations of 150 draws
    single = cross_spectra([(noise(2.0, 1), noise(2.0, 2)[:, None])], RATE_HZ)
    assert single.chance_of_mean(weights["even"])[0] == 1.0


def test_one_segment_has_no_significance():
    found = cross_spectra([(noise(2.0, 1), noise(2.0, 2)[:, None])], RATE_HZ)
    assert found.segments[0] == 1
    assert found.averages[0] == pytest.approx(1.0)
    assert found.coherence == pytest.approx(1.0)
    assert found.chance_coherence[0] == 1.0
    assert not (found.coherence > found.chance_coherence).any()


def test_overlapping_segments_have_fewer_degrees_of_freedom():
    # Hann windows half a length apart have a sixth of their energy in common: n / (1 + 2 / 36) for many.
    many = cross_spectra([(noise(400.0, 1), noise(400.0, 2)[:, None])], RATE_HZ)
    assert many.segments[0] == 399
    # It is the upper limit: noise is never quite even.
    share, limit = many.averages[0] / 399, 1.0 / (1.0 + 2.0 / 36.0)
    assert 0.99 * limit < share < 1.001 * limit
    apart = cross_spectra([(noise(40.0, 1), noise(40.0, 2)[:, None])], RATE_HZ, SpectrumSettings(overlap=0.0))
    assert apart.averages[0] == apart.segments[0] == 20


# --- masks -----------------------------------------------------------------------------------------------------------


def test_a_mask_leaves_out_its_segments_from_every_spectrum():
    x, y = noise(30.0, 1), np.column_stack([noise(30.0, 2), noise(30.0, 3), np.full(15000, np.nan)])
    masked = y.copy()
    masked[5000:5100, 0] = np.nan
    found = cross_spectra([(x, masked)], RATE_HZ)
    # The masked column gives the same as two records, one for each side of the mask.
    apart = cross_spectra([(x[:5000], y[:5000]), (x[5100:], y[5100:])], RATE_HZ)
    np.testing.assert_allclose(found.cross[:, 0], apart.cross[:, 0])
    np.testing.assert_allclose(found.input_psd[:, 0], apart.input_psd[:, 0])
    whole = cross_spectra([(x, y)], RATE_HZ)
    np.testing.assert_array_equal(found.cross[:, 1], whole.cross[:, 1])
    assert np.isnan(found.h1[:, 2]).all()
    assert np.isnan(found.coherence[:, 2]).all()
    assert found.segments.tolist() == [apart.segments[0], 29, 0]
    assert not (found.coherence[:, 2] > found.chance_coherence[2]).any()


def test_a_mask_of_the_input_counts_too():
    x, y = noise(30.0, 1), noise(30.0, 2)[:, None]
    x[5000] = np.nan
    found = cross_spectra([(x, y)], RATE_HZ)
    assert np.isfinite(found.h1).all()
    assert found.segments[0] == 9 + 18  # segments of 2 s every second, in 10 s less a sample and in 20 s less one


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: cross_spectra([(noise(1.9, 1), noise(1.9, 2)[:, None])], RATE_HZ), "no 2 s without a mask"),
        (lambda: cross_spectra([(noise(9, 1), noise(9, 2)[:, None])], 99.0), "half the sampling rate is 49.5 Hz"),
        (lambda: SpectrumSettings(window="henn"), "window 'henn' is unknown"),
        (lambda: SpectrumSettings(window="kaiser"), "needs a parameter"),
        (lambda: SpectrumSettings(lowest_hz=0.9), "below two steps of 0.5 Hz"),
        (lambda: SpectrumSettings(lowest_hz=5.0, highest_hz=4.0), "expected more than lowest_hz 5"),
        (lambda: SpectrumSettings(overlap=0.99), "overlap is 0.99, allowed are 0 to 0.9"),
        (lambda: common_rate_hz([1129.3, 500.0]), "records of 1129.3, 500 Hz cannot share spectra"),
    ],
)
def test_invalid_spectra_are_refused_in_one_line(call, message):
    with pytest.raises(InputError, match=message):
        call()


# --- transmissibility and driving point -------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def long_response() -> Response:
    """Subject 1, linear, for 600 s."""
    if not kernels.COMPILED:
        pytest.skip("without numba this takes many minutes")
    return simulated(linear(), 600.0)


def test_seat_to_head_transmissibility_is_the_papers_model(long_response):
    found = cross_spectra([(long_response.seat_mps2, long_response.accel_mps2)], long_response.rate_hz, FINE)
    head = peak(found.frequency_hz, np.abs(found.h1[:, HEAD]))
    assert head.magnitude == pytest.approx(3.0, abs=0.04)  # NOTES: 3.0 at 4.05 Hz
    assert head.frequency_hz == pytest.approx(4.05, abs=0.11)
    p = linear().parameters
    displacement = naive.transfer_functions(p.vector(), 58.6, "segment", found.frequency_hz)
    truth = 1.0 - (2.0 * np.pi * found.frequency_hz[:, None]) ** 2 * displacement
    slow = found.frequency_hz < 25.0  # above, less than a hundredth reaches the head
    np.testing.assert_allclose(found.h1[slow], truth[slow], rtol=0.05, atol=0.01)
    assert found.coherence[slow].min() > 0.99


@pytest.mark.parametrize("form", ["inertia", "joint"])
def test_apparent_mass_at_a_tenth_of_a_hertz_is_the_upper_body(form, long_response):
    slowly = SpectrumSettings(segment_s=100.0, lowest_hz=0.05, highest_hz=1.0)
    found = driving_point(linear(), [long_response], form, settings=slowly)
    at = np.argmin(abs(found.frequency_hz - 0.1))
    upper_body_kg = 58.6 * 0.581 * linear().parameters.mass_scale
    assert abs(found.apparent_mass_kg[at]) == pytest.approx(upper_body_kg, rel=5e-3)
    assert found.phase_deg[at] == pytest.approx(0.0, abs=0.3)
    assert found.by_upper_body_mass[at] == pytest.approx(1.0, rel=5e-3)
    assert found.by_body_mass[at] == pytest.approx(0.581 * linear().parameters.mass_scale, rel=5e-3)
    assert found.coherence[at] > 0.999


@pytest.mark.parametrize(("form", "peak_kg", "peak_hz"), [("joint", 60.4, 3.75), ("inertia", 62.9, 3.78)])
def test_apparent_mass_over_time_peaks_where_the_notes_say(form, peak_kg, peak_hz, long_response):
    found = driving_point(linear(), [long_response], form, settings=FINE)
    highest = peak(found.frequency_hz, np.abs(found.apparent_mass_kg))
    assert highest.magnitude == pytest.approx(peak_kg, rel=0.01)
    assert highest.frequency_hz == pytest.approx(peak_hz, abs=0.1)
    exact = linear_driving_point(linear(), found.frequency_hz, form)
    highest = peak(found.frequency_hz, np.abs(exact.apparent_mass_kg))
    assert highest.magnitude == pytest.approx(peak_kg, abs=0.06)
    # The seat is a straight line between samples, at 1000 Hz: 0.3 % at 40 Hz.
    np.testing.assert_allclose(found.apparent_mass_kg, exact.apparent_mass_kg, rtol=0.02, atol=0.4)


def test_the_printed_seat_force_points_the_wrong_way(long_response):
    found = driving_point(linear(), [long_response], "paper", settings=FINE)
    assert abs(found.phase_deg[0]) == pytest.approx(180.0, abs=2.0)


def test_several_responses_are_pooled_and_their_warm_up_left_out(long_response):
    def part(begin: int, end: int) -> Response:
        r, rows = long_response, slice(begin, end)
        columns = (r.seat_mps2, r.accel_mps2, r.displacement_m, r.velocity_mps, r.joint_force_n)
        return Response(r.rate_hz, *(column[rows].copy() for column in columns))

    both = [part(0, 60_000), part(60_000, 120_000)]
    settled = [(r.seat_mps2[2000:], (r.accel_mps2[2000:] @ Chain.of(linear()).mass_kg)[:, None]) for r in both]
    for response in both:
        response.accel_mps2[:2000] = 1e6
    found = driving_point(linear(), both)
    np.testing.assert_allclose(found.apparent_mass_kg, cross_spectra(settled, 1000.0).h1[:, 0], rtol=1e-12)


def test_impedance_is_force_over_the_integrated_velocity(long_response):
    found = driving_point(linear(), [long_response], settings=FINE)
    behind = slice(2000, None)
    seat, force = long_response.seat_mps2[behind], (long_response.accel_mps2 @ Chain.of(linear()).mass_kg)[behind]
    velocity = integrate.cumulative_trapezoid(seat, dx=1e-3, initial=0.0)  # the paper's 4.2
    how = {"fs": 1000.0, "nperseg": 20_000, "detrend": "linear"}
    frequency, cross = signal.csd(velocity, force, **how)
    printed = cross / signal.welch(velocity, **how)[1]
    band = (frequency > 0.499) & (frequency < 40.001)
    above = found.frequency_hz > 1.0
    np.testing.assert_allclose(found.impedance_n_s_per_m[above], printed[band][above], rtol=0.03)
    assert np.abs(found.impedance_n_s_per_m[0]) == pytest.approx(2.0 * np.pi * 0.5 * 34.7, rel=0.02)  # a mass, nearly


def test_the_linear_driving_point_is_the_slow_twins():
    frequency = np.arange(0.5, 40.0, 0.5)
    found = linear_driving_point(linear(), frequency)
    p = linear().parameters
    displacement = naive.transfer_functions(p.vector(), 58.6, "segment", frequency)
    mass = 58.6 * p.mass_scale * np.array(naive.MASS_FRACTION)
    force = (1.0 - (2.0 * np.pi * frequency[:, None]) ** 2 * displacement) @ mass
    np.testing.assert_allclose(found.apparent_mass_kg, force, rtol=1e-9)
    np.testing.assert_allclose(found.impedance_n_s_per_m, 2j * np.pi * frequency * force, rtol=1e-9)


def test_forces_of_three_bodies_are_refused_unless_asked_for():
    subject = load_subject(subject_file("subject_1_as_printed"))
    response = simulated(subject, 20.0)
    with pytest.raises(InputError, match="as_printed"):
        driving_point(subject, [response])
    with pytest.raises(InputError, match="as_printed"):
        linear_driving_point(subject, np.array([1.0]))
    printed = driving_point(subject, [response], as_printed=True)
    assert printed.by_upper_body_mass[0] > 2.5


# --- peaks -----------------------------------------------------------------------------------------------------------


def test_a_peak_is_searched_within_its_flags():
    frequency = np.arange(5.0)
    magnitude = np.array([1.0, np.nan, 5.0, 2.0, 3.0])
    assert peak(frequency, magnitude) == (2.0, 5.0)
    assert peak(frequency, magnitude, np.array([True, True, False, True, True])) == (4.0, 3.0)
    assert peak(frequency, magnitude, np.array([False, True, False, False, False])) is None
    assert peak(frequency, np.full(5, np.nan)) is None
