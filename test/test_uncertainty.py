"""Coverage of intervals, and the classification of parameters that the data do not identify."""

import dataclasses

import fitting
import numpy as np
import pytest
from scipy import signal
from scipy.interpolate import CubicSpline

from biodyn_core.base.errors import InputError
from biodyn_core.base.quantiles import NORMAL_95
from biodyn_core.base.segments import MEASURED_SEGMENT_INDEX
from biodyn_core.body.model import Chain
from biodyn_core.body.parameters import LOWER, PARAMETERS, UPPER, Parameters
from biodyn_core.body.subject import Subject
from biodyn_core.identification.fit import Fit
from biodyn_core.identification.objectives import RegularizationTerm, TimeDomain
from biodyn_core.identification.phase2 import Refined, least_squares
from biodyn_core.identification.problem import Case
from biodyn_core.identification.profiles import profile
from biodyn_core.identification.residuals import residual_checks
from biodyn_core.identification.settings import FitSettings
from biodyn_core.identification.uncertainty import (
    WEAK_PRIOR_SPREAD,
    WINDOW_STEPS,
    Uncertainty,
    UncertaintySettings,
    covariance_of,
    inverse_of,
    jackknifed,
    overlapping_windows,
    sandwich,
    uncertainty,
    weak_prior,
)

NAMES = [p.name for p in PARAMETERS]
RESIDUALS_ALONE = UncertaintySettings(cross_axis=0.0)


def fitted(subject: Subject, cases: list[Case], settings: FitSettings | None = None) -> Fit:
    """The result of a fit that starts at the truth; other tests check searches."""
    s = settings or FitSettings(lambda_2=0.0)
    truth = fitting.theta_of(subject)
    problem = TimeDomain(cases, subject, RegularizationTerm(truth, s.lambda_2, s.regularization), s.clocks)
    theta, objective = least_squares(problem, truth, s.free, 3000)
    found = Refined(theta, truth, objective, np.array([objective]), problem.evaluations, problem.penalties)
    return Fit.of(found, cases, subject, s)


def answered(subject: Subject, seat: np.ndarray) -> np.ndarray:
    """Measured segments of the model itself, (n, 5): tested here is the propagation of noise."""
    return Chain.of(subject).simulate(seat, fitting.RATE_HZ).accel_mps2[:, MEASURED_SEGMENT_INDEX]


def coloured(shape: tuple[int, ...], rng: np.random.Generator) -> np.ndarray:
    """Noise of 0.1 m/s^2 rms below 12 Hz, (n, ...)."""
    sos = signal.butter(2, 12.0, fs=fitting.RATE_HZ, output="sos")
    noise = signal.sosfilt(sos, rng.standard_normal(shape), axis=0)
    return 0.1 * noise / noise.std(axis=0)


def call_of(found: Uncertainty, name: str) -> str:
    return next(estimate.identifiability for estimate in found.estimates if estimate.name == name)


@pytest.mark.slow
def test_intervals_have_their_stated_coverage() -> None:
    """24 records whose noise is coloured and reaches every segment from the seat's sensor as well as from its own."""
    subject, rng = fitting.drawn(21, "segment"), np.random.default_rng(5)
    seats = [fitting.seat_motion("road", 12.0, 1), fitting.seat_motion("pothole", 8.0, 2)]
    clean = [answered(subject, seat) for seat in seats]
    inside, too_short = [], []
    for _ in range(24):
        cases = [
            fitting.ready(seat + 0.5 * coloured(seat.shape, rng), accel + coloured(accel.shape, rng))
            for seat, accel in zip(seats, clean, strict=True)
        ]
        fit = fitted(subject, cases)
        found = uncertainty(fit, cases, RESIDUALS_ALONE)
        truth = fitting.theta_of(subject)[:14]
        inside += [e.lower <= true <= e.upper for e, true in zip(found.estimates, truth, strict=True)]
        white = white_half_widths(fit, cases)
        off = np.abs(np.log(fitting.theta_of(fit.subject)[:14] / truth))
        too_short += (off > white).tolist()
    assert 0.88 <= np.mean(inside) <= 0.99
    assert np.mean(too_short) > 0.3  # what the textbook's formula for white noise would have missed


def white_half_widths(fit: Fit, cases: list[Case]) -> np.ndarray:
    """Half widths from s^2 (J'J)^-1, as if every sample were a measurement of its own."""
    residuals, slopes = fit.objective(cases).linearised(fitting.theta_of(fit.subject), fit.settings.free)
    samples = sum(int(case.compared.sum()) for case in cases)
    return NORMAL_95 * np.sqrt(np.diag(np.linalg.inv(slopes.T @ slopes)) * (residuals @ residuals) / samples)


def made_rows(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Slopes (n, 5, 3) and a residual (n, 5), the one as a least-squares fit leaves it."""
    rng = np.random.default_rng(seed)
    slopes, target = rng.standard_normal((count, 5, 3)), rng.standard_normal((count, 5))
    flat = slopes.reshape(-1, 3)
    return slopes, target - slopes @ np.linalg.lstsq(flat, target.ravel())[0]


def test_overlapping_windows_are_bartletts_triangle() -> None:
    slopes, residual = made_rows(43, 0)
    scores = np.einsum("nsp,ns->np", slopes, residual)
    expected = np.zeros((3, 3))
    for t in range(43):
        for u in range(43):
            expected += max(0.0, 1.0 - abs(t - u) / WINDOW_STEPS) * np.outer(scores[t], scores[u])
    found = jackknifed(*overlapping_windows(slopes, residual, WINDOW_STEPS), np.zeros((3, 3)))
    np.testing.assert_allclose(found, expected, rtol=1e-5)


def test_each_window_is_compared_with_the_fit_without_it() -> None:
    slopes, residual = made_rows(60, 1)
    inverse = np.linalg.inv(slopes.reshape(-1, 3).T @ slopes.reshape(-1, 3))
    expected = np.zeros((3, 3))
    for end in range(2, 60 + 20, 2):  # windows of 20 that begin every 2, those that reach past the ends too
        kept = np.ones(60, dtype=bool)
        kept[max(0, end - 20) : end] = False
        moved = np.linalg.lstsq(slopes[kept].reshape(-1, 3), residual[kept].ravel())[0]
        expected += np.outer(moved, moved) / WINDOW_STEPS
    scatter = jackknifed(*overlapping_windows(slopes, residual, 20), inverse)
    np.testing.assert_allclose(inverse @ scatter @ inverse, expected, rtol=1e-4)


def test_a_record_as_short_as_a_window_is_not_known_better_than_a_longer_one() -> None:
    subject, rng = fitting.drawn(28, "segment"), np.random.default_rng(8)
    seat = fitting.seat_motion("pothole", 12.0, 5)
    accel = answered(subject, seat) + coloured((seat.size, 5), rng)
    short = round(2.8 * fitting.RATE_HZ)
    cases = [fitting.ready(seat[:n], accel[:n]) for n in (short, seat.size)]
    half = [[e.half_width for e in uncertainty(fitted(subject, [case]), [case]).estimates] for case in cases]
    assert np.median(half[0]) > 3.0 * np.median(half[1])


def test_the_inverse_covers_observable_and_unobservable_parameters() -> None:
    seen = np.array([[4.0, 1.0, 0.0], [1.0, 3.0, 0.0], [0.0, 0.0, 0.0]])
    found = inverse_of(seen)
    np.testing.assert_allclose(found[:2, :2], np.linalg.inv(seen[:2, :2]), rtol=1e-12)
    assert found[2, 2] > 1e200


def with_weak_prior(information: np.ndarray, scatter: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    weak, of_weak = weak_prior(information, scatter)
    inverse = inverse_of(information + weak)
    return sandwich(inverse, scatter + of_weak), inverse


def test_an_unknown_direction_does_not_blur_what_is_known() -> None:
    """Information with eigenvalues 1e-9 to 2e4; the variances along its axes are known."""
    vectors = np.linalg.qr(np.random.default_rng(3).standard_normal((5, 5)))[0]
    squares, noise = np.array([1e-13, 0.3, 0.7, 1.0, 2.0]) * 1e4, 0.5
    information = (vectors * squares) @ vectors.T
    covariance, inverse = with_weak_prior(information, noise * information)
    known = vectors[:, 1:]
    np.testing.assert_allclose(known.T @ covariance @ known, np.diag(noise / squares[1:]), rtol=1e-6, atol=1e-11)
    np.testing.assert_allclose(known.T @ inverse @ known, np.diag(1.0 / squares[1:]), rtol=1e-6, atol=1e-11)
    assert vectors[:, 0] @ covariance @ vectors[:, 0] == pytest.approx(WEAK_PRIOR_SPREAD**2, rel=1e-3)
    assert np.linalg.eigvalsh(covariance)[0] > 0.0


def test_a_parameter_without_information_leaves_the_others_as_without_it() -> None:
    """Its slopes are rounding noise, which correlates with those of the others as it happens."""
    rng = np.random.default_rng(4)
    slopes, scores = rng.standard_normal((2, 40, 6))
    slopes[:, 5] *= 1e-9
    scores[:, 5] *= 1e-9
    information, scatter = slopes.T @ slopes, scores.T @ scores
    covariance, inverse = with_weak_prior(information, scatter)
    seen = np.linalg.inv(information[:5, :5])
    np.testing.assert_allclose(inverse[:5, :5], seen, rtol=1e-4)
    np.testing.assert_allclose(covariance[:5, :5], seen @ scatter[:5, :5] @ seen, rtol=1e-4)
    assert covariance[5, 5] == pytest.approx(WEAK_PRIOR_SPREAD**2, rel=1e-4)


def quiet_road(rms_mps2: float, seed: int = 1) -> np.ndarray:
    seat = fitting.seat_motion("road", 10.0, seed)
    return seat * rms_mps2 / seat.std()


def soft_subject() -> Subject:
    """Little stiffening, as the paper's subject 2 has it (s_nl = 0.5)."""
    theta = fitting.theta_of(fitting.drawn(22, "segment"))
    theta[13] = 0.5
    return Subject("soft", 70.0, 1.75, "segment", Parameters.from_vector(theta))


def test_stiffening_is_identifiable_from_a_shock_and_not_from_a_quiet_road() -> None:
    subject, rng = soft_subject(), np.random.default_rng(3)
    calls = {}
    for name, seat in (("road", quiet_road(0.3)), ("shock", fitting.seat_motion("rail", 16.0, 2))):
        case = fitting.ready(seat, answered(subject, seat) + coloured((seat.size, 5), rng))
        calls[name] = uncertainty(fitted(subject, [case]), [case])
    assert call_of(calls["road"], "stiffening_scale") == "not identifiable"
    assert call_of(calls["shock"], "stiffening_scale") == "identifiable"
    for joint in ("pelvis", "lower_torso", "neck", "head"):
        assert call_of(calls["shock"], f"natural_frequency_hz[{joint}]") == "identifiable"


def test_the_mass_scale_is_not_identifiable() -> None:
    subject = fitting.drawn(23, "segment")
    seat = fitting.seat_motion("pothole", 6.0, 4)
    case = fitting.ready(seat, answered(subject, seat) + coloured((seat.size, 5), np.random.default_rng(1)))
    fit = fitted(subject, [case], FitSettings(lambda_2=0.0, mass_scale="free"))
    found = {e.name: e for e in uncertainty(fit, [case]).estimates}
    assert found["mass_scale"].identifiability == "not identifiable"
    assert (found["mass_scale"].lower, found["mass_scale"].upper) == (0.85, 1.15)
    assert found["natural_frequency_hz[head]"].identifiability == "identifiable"


def test_a_free_mass_scale_leaves_the_covariance_of_the_others_as_it_is() -> None:
    subject = fitting.drawn(23, "segment")
    seat = fitting.seat_motion("pothole", 6.0, 4)
    case = fitting.ready(seat, answered(subject, seat) + coloured((seat.size, 5), np.random.default_rng(1)))
    fit = fitted(subject, [case])
    theta, every = fit.subject.parameters.vector(), np.ones(15, dtype=bool)
    fixed, free = (covariance_of(fit.objective([case]), theta, one, UncertaintySettings())[0] for one in (
        fit.settings.free, every,
    ))  # fmt: skip
    np.testing.assert_allclose(np.diag(free)[:14], np.diag(fixed), rtol=1e-4)
    assert free[14, 14] == pytest.approx(WEAK_PRIOR_SPREAD**2, rel=1e-4)


def test_joints_3_and_4_are_identifiable_only_jointly_from_slow_motion() -> None:
    """Far below resonance the torso stretches by its compliance alone: 1/f_3^2 + 1/f_4^2 is all that shows."""
    subject, rng = fitting.drawn(24, "segment"), np.random.default_rng(2)
    white = rng.standard_normal(round(20 * fitting.RATE_HZ))
    seat = signal.sosfiltfilt(signal.butter(4, [0.3, 1.2], "bandpass", fs=fitting.RATE_HZ, output="sos"), white)
    seat *= 5.0 / seat.std()
    noise = 0.02 * coloured((seat.size, 5), rng)
    case = fitting.ready(seat, answered(subject, seat) + noise)
    settings = dataclasses.replace(FitSettings(), lambda_2=1e-12)
    found = uncertainty(fitted(subject, [case], settings), [case], RESIDUALS_ALONE)
    at = [found.names.index(f"natural_frequency_hz[{joint}]") for joint in ("central_torso", "upper_torso")]
    squares, shares = np.linalg.eigh(found.covariance[np.ix_(at, at)])
    assert (np.sqrt(np.diag(found.covariance)[at]) > 10.0 * np.sqrt(squares[0])).all()
    assert shares[0, 0] * shares[1, 0] > 0.0  # stiffer below, softer above: that is what goes unseen


def test_systematic_sensor_errors_bound_the_intervals_from_below() -> None:
    subject, rng = fitting.drawn(25, "cascade"), np.random.default_rng(4)
    widths: dict[float, list[np.ndarray]] = {0.0: [], 0.002: []}
    for seconds in (6.0, 38.0):
        seat = fitting.seat_motion("road", seconds, 3)
        case = fitting.ready(seat, answered(subject, seat) + 0.2 * coloured((seat.size, 5), rng))
        for share, found in widths.items():
            made = uncertainty(fitted(subject, [case]), [case], UncertaintySettings(cross_axis=share))
            found.append(np.array([e.half_width for e in made.estimates]))
    narrower = {share: np.median(short / long) for share, (short, long) in widths.items()}
    assert narrower[0.0] == pytest.approx(3.0, rel=0.4)  # root of 36 s over 4 s
    assert narrower[0.002] < 0.75 * narrower[0.0]
    assert (widths[0.002][1] > widths[0.0][1]).all()


def test_a_parameter_on_a_bound_is_named_and_has_no_interval() -> None:
    subject = fitting.drawn(26, "segment")
    seat = fitting.seat_motion("pothole", 6.0, 4)
    case = fitting.ready(seat, answered(subject, seat) + coloured((seat.size, 5), np.random.default_rng(1)))
    fit = dataclasses.replace(fitted(subject, [case]), at_bound=("damping_ratio[neck]",))
    found = uncertainty(fit, [case])
    neck = next(e for e in found.estimates if e.name == "damping_ratio[neck]")
    assert neck.at_bound and neck.identifiability == "not identifiable" and np.isinf(neck.half_width)
    assert (neck.lower, neck.upper) == (LOWER[10], UPPER[10])
    assert found.names == tuple(name for name in NAMES[:14] if name != "damping_ratio[neck]")
    with pytest.raises(InputError, match="not fitted, or on a bound"):
        profile(fit, [case], "damping_ratio[neck]")
    with pytest.raises(InputError, match="mass_scale: not fitted"):
        profile(fit, [case], "mass_scale")


@pytest.mark.slow
def test_profiles_are_closed_for_identifiable_parameters_and_open_for_others() -> None:
    subject, rng = soft_subject(), np.random.default_rng(6)
    seat = quiet_road(0.3)
    case = fitting.ready(seat, answered(subject, seat) + coloured((seat.size, 5), rng))
    fit = fitted(subject, [case])
    head = next(e for e in uncertainty(fit, [case]).estimates if e.name == "natural_frequency_hz[head]")
    drawn = profile(fit, [case], head.name)
    assert drawn.lower == pytest.approx(head.lower, rel=0.1 * head.half_width)
    assert drawn.upper == pytest.approx(head.upper, rel=0.1 * head.half_width)
    assert (np.diff(drawn.values) > 0.0).all() and drawn.rise.min() > -1e-9
    stiffening = profile(fit, [case], "stiffening_scale")
    assert stiffening.lower is None
    assert stiffening.values[0] == LOWER[13]


def test_a_profile_is_that_of_the_recordings_also_where_the_fit_is_not_at_their_minimum() -> None:
    """A fit that a strong regularization draws away, or whose descent is stopped, has the profile of a settled one."""
    subject, seat = fitting.drawn(26, "segment"), fitting.seat_motion("pothole", 6.0, 4)
    case = fitting.ready(seat, answered(subject, seat) + coloured((seat.size, 5), np.random.default_rng(1)))
    settled = fitted(subject, [case])
    away = fitting.theta_of(settled.subject) * np.where(np.array(NAMES) == "damping_ratio[neck]", 1.2, 1.0)
    moved = dataclasses.replace(settled.subject, parameters=Parameters.from_vector(away))
    name = "natural_frequency_hz[head]"
    one, other = (profile(dataclasses.replace(settled, subject=of), [case], name) for of in (settled.subject, moved))
    assert other.rise.min() == 0.0
    assert (other.lower, other.upper) == (pytest.approx(one.lower, rel=1e-4), pytest.approx(one.upper, rel=1e-4))


def test_a_misfit_does_not_contain_the_clocks_that_the_fit_estimates() -> None:
    """A sensor that is 1 ms late is predicted worse, and determines the parameters as well."""
    subject, seat = fitting.drawn(26, "segment"), fitting.seat_motion("road", 6.0, 4)
    accel = answered(subject, seat) + coloured((seat.size, 5), np.random.default_rng(1))
    late = CubicSpline(np.arange(len(accel)), accel)(np.arange(len(accel)) - 1e-3 * fitting.RATE_HZ)
    one, other = (fitted(subject, [fitting.ready(seat, values)]) for values in (accel, late))
    assert other.error_percent > 1.2 * one.error_percent
    assert other.misfit_percent == pytest.approx(one.misfit_percent, rel=0.02)
    trusting = fitted(subject, [fitting.ready(seat, late)], FitSettings(lambda_2=0.0, clocks="trusted"))
    assert trusting.misfit_percent == pytest.approx(trusting.error_percent, rel=1e-9)


def test_intervals_contain_the_minimum_that_a_regularization_keeps_the_fit_away_from() -> None:
    subject, seat = fitting.drawn(26, "segment"), fitting.seat_motion("pothole", 6.0, 4)
    case = fitting.ready(seat, answered(subject, seat) + coloured((seat.size, 5), np.random.default_rng(1)))
    free = fitted(subject, [case])
    reference = 1.2 * fitting.theta_of(free.subject)
    problem = TimeDomain([case], subject, RegularizationTerm(reference, 1e-3), free.settings.clocks)
    start, end = fitting.theta_of(free.subject), np.full(15, np.nan)
    end, _ = least_squares(problem, start, free.settings.free, 2000)
    drawn = dataclasses.replace(subject, parameters=Parameters.from_vector(end))
    held = dataclasses.replace(free, subject=drawn, refined=dataclasses.replace(free.refined, theta=end))
    widths, own = (
        {one.name: one.half_width for one in uncertainty(fit, [case]).estimates if not one.at_bound}
        for fit in (held, free)
    )
    away = {name: abs(float(np.log(end[i] / start[i]))) for i, name in enumerate(NAMES)}
    assert max(away[name] / own[name] for name in own) > 1.5  # the intervals of the minimum do not contain the fit
    for name, width in widths.items():
        assert away[name] < width, name


def test_the_colour_of_the_low_pass_does_not_count() -> None:
    seat, rng = fitting.seat_motion("road", 20.0, 4), np.random.default_rng(7)
    subject = fitting.drawn(27, "segment")
    low = signal.butter(4, 40.0, fs=fitting.RATE_HZ, output="sos")
    noise = signal.sosfiltfilt(low, 0.1 * rng.standard_normal((seat.size, 5)), axis=0)
    case = fitting.ready(seat, answered(subject, seat) + noise)
    fit = dataclasses.replace(fitted(subject, [case]), subject=subject)
    (as_it_is,) = residual_checks(fit, [case], fitting.SPECTRUM, cutoff_hz=40.0)
    (as_if_wider,) = residual_checks(fit, [case], fitting.SPECTRUM)
    # 19 lags a segment, of which one in twenty lies outside by chance.
    assert as_it_is.coloured.mean() < 0.15 and as_if_wider.coloured.mean() > 0.3


def test_residuals_distinguish_noise_from_response_to_the_seat() -> None:
    subject, rng = fitting.drawn(27, "segment"), np.random.default_rng(7)
    seat = fitting.seat_motion("road", 20.0, 4)
    noise = fitting.low_passed(0.1 * rng.standard_normal((seat.size, 5)))
    accel = answered(subject, seat) + noise
    accel[:, 4] += 0.1 * np.concatenate([np.zeros(12), seat[:-12]])
    case = fitting.ready(seat, accel)
    fit = dataclasses.replace(fitted(subject, [case]), subject=subject)
    (found,) = residual_checks(fit, [case], fitting.SPECTRUM)
    assert (found.coherent[:4] < found.chance[:4]).all() and found.coherent[4] > 3.0 * found.chance[4]
    assert (found.coloured[:4] < 0.2).all() and found.coloured[4] > 0.3


def test_settings_are_checked() -> None:
    with pytest.raises(InputError, match="cross_axis"):
        UncertaintySettings(cross_axis=-0.1)
