"""Intervals of predictions: their two parts against figures computed otherwise, and the reasons where there is none."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from paper import shipped
from provenances import with_spread
from streams import in_bursts, in_turn, noisy_streams, quantised, run

from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import SEGMENTS
from biodyn_core.body.model import Chain
from biodyn_core.body.parameter_spread import largest_steps, neighbours, parameter_spread
from biodyn_core.body.usual_residual import PROVENANCE, UsualResidual
from biodyn_core.conditioning.conditioned import Block
from biodyn_core.exposure.figure_spread import (
    ACCEL_FACTORS,
    FORCE_FACTORS,
    FigureSpread,
    PeakSpreadMeter,
    SpreadMeter,
    interval,
    mean_square_change,
)
from biodyn_core.exposure.figure_spread import (
    spread as spread_of,
)
from biodyn_core.exposure.meters import DoseMeter
from biodyn_core.pipeline.intervals import NEIGHBOURS, IntervalEstimator, SegmentSpread, carried, prediction_spread
from biodyn_core.pipeline.pipeline import Pipeline
from biodyn_core.population.population import new_subject
from biodyn_core.signals.octaves import N_BANDS

RATE_HZ = 1130.0
EPOCH_NS = 1_700_000_000 * 10**9
SUBJECT = with_spread(shipped("subject_1"))


def seat(seconds: float = 8.0, seed: int = 3) -> np.ndarray:
    """A rough road that rises from rest."""
    rng = np.random.default_rng(seed)
    count = round(seconds * RATE_HZ)
    smooth = np.convolve(rng.standard_normal(count + 60), np.hanning(61) / 30.0, "valid")
    return smooth * np.clip(np.arange(count) / RATE_HZ, 0.0, 1.0) * 5.0


def block(seat_mps2: np.ndarray, begin: int, end: int, begins_run: bool, gap_s: float = 0.0) -> Block:
    stamps_ns = EPOCH_NS + np.rint(np.arange(begin, end) * 1e9 / RATE_HZ).astype(np.int64)
    part = seat_mps2[begin:end]
    return Block(
        stamps_ns, 1e-9 * (stamps_ns - EPOCH_NS), np.zeros((end - begin, 3)), part, begins_run, gap_s, EPOCH_NS,
        RATE_HZ, 100.0,
    )  # fmt: skip


def estimated(subject=SUBJECT, cuts: tuple[int, ...] = (), seconds: float = 8.0) -> IntervalEstimator:
    """The estimator after a drive."""
    spread, why = prediction_spread(subject)
    assert spread is not None and why == ""
    motion = seat(seconds)
    accel = Chain.of(subject).simulate(motion, RATE_HZ).accel_mps2
    found = IntervalEstimator(spread, RATE_HZ, 60.0)
    for begin, end in pairwise([0, *cuts, motion.size]):
        if end > begin:
            found.push(block(motion, begin, end, begin == 0), accel[begin:end])
    return found


def by_segment(found: IntervalEstimator, rolling: bool = False) -> dict[str, SegmentSpread]:
    return found.spreads(rolling)


# --- the figures -----------------------------------------------------------------------------------------------------


def test_an_interval_is_a_factor_on_both_sides() -> None:
    lower, upper = interval(2.0, 0.1)
    assert lower == pytest.approx(2.0 * math.exp(-0.1959964)) and upper == pytest.approx(2.0 * math.exp(0.1959964))
    assert interval(2.0, 0.0) == (2.0, 2.0)


def test_one_window_by_hand() -> None:
    meter = SpreadMeter([ACCEL_FACTORS, FORCE_FACTORS], 2, 60.0)
    assert meter.since_reset() == (None, None)
    meter.push(np.array([4.0, 1.0]), np.array([0.04, 0.01]), np.array([[4.0 * math.exp(0.1), 4.0], [1.0, 1.0]]))
    first, second = meter.since_reset()
    assert first is not None and second is not None
    expected = FigureSpread(0.1 * FORCE_FACTORS.doses, 0.1 * FORCE_FACTORS.doses, 0.1 * FORCE_FACTORS.peaks)
    assert vars(second) == pytest.approx(vars(expected))
    assert first.of_means == pytest.approx(math.hypot(ACCEL_FACTORS.doses * 0.1, 0.05))
    assert first.of_vdv == pytest.approx(first.of_means)
    assert first.of_peaks == pytest.approx(math.hypot(ACCEL_FACTORS.peaks * 0.1, 0.05))


def test_both_sides_have_the_mean_square_of_a_parabola() -> None:
    """Y = a x + b x^2 of a normal x has the mean square a^2 + 3 b^2; by one side it would be (a + b)^2."""
    slope, bend = np.array([0.2, 0.1]), np.array([-0.2, 0.05])
    ahead, back = slope + bend, -slope + bend
    x = np.random.default_rng(0).normal(size=(400_000, 2))
    drawn = float(np.mean((x @ slope + x**2 @ bend) ** 2))
    assert mean_square_change(np.append(ahead, back), both_sides=True) == pytest.approx(drawn, rel=0.02)
    assert mean_square_change(ahead, both_sides=False) == pytest.approx(0.15**2)
    squares = np.exp(2.0 * np.append(0.0, np.append(ahead, back)))
    found = spread_of(np.array([squares[0], 0.0, *squares[1:]]), 1.0, 0.5, both_sides=True)
    assert found == pytest.approx(math.sqrt(drawn), rel=0.01)


def test_peaks_spread_as_those_of_each_chain() -> None:
    """Peaks in different windows; the second channel never pulls."""
    meter = PeakSpreadMeter(2, 3, 60.0)
    first = np.array([[[1.0, 5.0], [2.0, 5.0], [3.0, 5.0]], [[-2.0, 4.0], [-1.0, 4.0], [-1.0, 4.0]]])
    second = np.array([[[4.0, 1.0], [1.0, 1.0], [1.0, 1.0]]])
    for window in (first, second):
        meter.push(window)
    one, other = meter.since_reset()
    up = mean_square_change(np.log(np.array([2.0, 3.0]) / 4.0), both_sides=True)
    down = mean_square_change(np.log(np.array([1.0, 1.0]) / 2.0), both_sides=True)
    assert (one.of_positive, one.of_negative) == pytest.approx((math.sqrt(up), math.sqrt(down)))
    assert (other.of_positive, other.of_negative) == (0.0, None)
    another = PeakSpreadMeter(2, 3, 60.0)
    another.resume(meter.totals())
    assert another.since_reset() == meter.since_reset() and another.rolling()[0].of_positive is None


def test_vdv_follows_the_strong_windows_and_means_all() -> None:
    meter = SpreadMeter([ACCEL_FACTORS], 0, 60.0)
    none = np.empty((1, 0))
    for square, error in ((1.0, 0.01), (9.0, 0.81)):
        meter.push(np.array([square]), np.array([error]), none)
    (found,) = meter.since_reset()
    assert found is not None
    assert found.of_means == pytest.approx(ACCEL_FACTORS.doses * math.sqrt(0.82 / 10.0))
    assert found.of_vdv == pytest.approx(ACCEL_FACTORS.doses * math.sqrt((0.01 * 1.0 + 0.81 * 9.0) / (1.0 + 81.0)))


def test_the_rolling_spread_forgets_old_windows() -> None:
    meter = SpreadMeter([ACCEL_FACTORS], 0, 5.0)
    for error in (0.25, *[0.01] * 6):
        meter.push(np.ones(1), np.array([error]), np.empty((1, 0)))
    (since,), (rolling,) = meter.since_reset(), meter.rolling()
    assert since is not None and rolling is not None
    assert rolling.of_means == pytest.approx(0.1 * ACCEL_FACTORS.doses) and since.of_means > rolling.of_means
    meter.reset()
    assert meter.since_reset() == (None,) and meter.rolling()[0] is not None


def test_totals_continue_in_another_run() -> None:
    one, other = (SpreadMeter([ACCEL_FACTORS], 1, 60.0) for _ in range(2))
    for meter, error in ((one, 0.04), (other, 0.01)):
        meter.push(np.ones(1), np.array([error]), np.array([[1.1]]))
    other.resume(one.totals())
    (found,) = other.since_reset()
    assert found is not None
    assert found.of_means == pytest.approx(math.hypot(ACCEL_FACTORS.doses * math.sqrt(0.025), 0.5 * math.log(1.1)))
    with pytest.raises(InputError, match="below zero"):
        other.resume(-one.totals())


# --- the estimator ---------------------------------------------------------------------------------------------------


def test_a_share_of_all_bands_is_the_spread_of_every_segment() -> None:
    """With parameters that are known, the spread is the share times the factor, whatever the motion."""
    found = by_segment(estimated(with_spread(shipped("subject_1"), share=0.2, spread=1e-9)))
    assert tuple(found) == SEGMENTS
    for spread in found.values():
        assert spread.accel.of_means == pytest.approx(0.2 * ACCEL_FACTORS.doses, rel=1e-6)
        assert spread.accel.of_peaks == pytest.approx(0.2 * ACCEL_FACTORS.peaks, rel=1e-6)
    # Errors of the segments above a joint may all have one sign, so the whole is not less sure than the share.
    forces = [spread.force.of_rms / (0.2 * FORCE_FACTORS.doses) for spread in found.values()]
    assert min(forces) > 0.9 and max(forces) < 2.0


def test_parameters_alone_give_the_difference_of_the_neighbours() -> None:
    """Aw of the neighbouring chains by the meter of doses, sample by sample."""
    subject = with_spread(shipped("subject_1"), share=1e-9)
    spread, _ = parameter_spread(subject.provenance)
    assert spread is not None
    motion = seat(31.0)

    def aw(chain: Chain) -> np.ndarray:
        meter = DoseMeter("Wk", RATE_HZ, 6, 60.0)
        meter.push(chain.simulate(motion, RATE_HZ).accel_mps2)
        return np.array([dose.aw_mps2 for dose in meter.since_reset()])

    steps = largest_steps(subject, spread, NEIGHBOURS)
    changes = [np.log(aw(chain) / aw(Chain.of(subject))) for chain in neighbours(subject, steps)]
    expected = np.sqrt(np.sum(np.square(changes), axis=0))
    found = [one.accel.of_means for one in by_segment(estimated(subject, seconds=31.0)).values()]
    # Spectra of one second are coarser than the filters.
    np.testing.assert_allclose(found, expected, rtol=0.2)


def weighted_peaks(accel_mps2: np.ndarray) -> np.ndarray:
    """Weighted peaks (6,) of accelerations (n, 6), by the meter of doses."""
    meter = DoseMeter("Wk", RATE_HZ, 6, 60.0)
    meter.push(np.ascontiguousarray(accel_mps2))
    return np.array([dose.peak_mps2 for dose in meter.since_reset()])


def test_weighted_peaks_of_a_group_spread_as_those_of_each_chain() -> None:
    """A bump of 35 ms: its samples decide, and not the second with the largest mean."""
    subject, motion = new_subject("me", 75.0, 1.75), seat()
    motion[4000:4040] += 12.0 * np.hanning(40)
    spread, why = prediction_spread(subject)
    assert spread is not None and spread.both_sides and why == ""
    accel = Chain.of(subject).simulate(motion, RATE_HZ).accel_mps2
    found = IntervalEstimator(spread, RATE_HZ, 60.0)
    stamps_ns = block(motion, 0, motion.size, True).stamps_ns
    found.push_run(stamps_ns, motion, accel, 0)
    own = weighted_peaks(accel)
    changes = [np.log(weighted_peaks(chain.simulate(motion, RATE_HZ).accel_mps2) / own) for chain in spread.chains]
    expected = [math.sqrt(mean_square_change(one, both_sides=True)) for one in np.transpose(changes)]
    np.testing.assert_allclose([one.accel.of_peaks for one in by_segment(found).values()], expected, rtol=1e-6)
    # The same live, in blocks; its rolling figures too.
    live = IntervalEstimator(spread, RATE_HZ, 60.0)
    for begin in range(0, motion.size, 700):
        end = min(begin + 700, motion.size)
        live.push(block(motion, begin, end, begin == 0), accel[begin:end])
    for rolling in (False, True):
        np.testing.assert_allclose([x.accel.of_peaks for x in by_segment(live, rolling).values()], expected, rtol=1e-6)


def test_a_prediction_without_a_number_does_not_stay_in_the_weighted_peaks() -> None:
    subject, motion = new_subject("me", 75.0, 1.75), seat()
    spread, _ = prediction_spread(subject)
    assert spread is not None
    accel = Chain.of(subject).simulate(motion, RATE_HZ).accel_mps2
    expected, found = (IntervalEstimator(spread, RATE_HZ, 60.0) for _ in range(2))
    stamps_ns = block(motion, 0, motion.size, True).stamps_ns
    spoiled = accel.copy()
    spoiled[500] = np.nan  # in the first, quiet second
    expected.push_run(stamps_ns, motion, accel, 0)
    found.push_run(stamps_ns, motion, spoiled, 0)
    assert len(found.recent) == len(expected.recent) - 1
    for name, one in by_segment(found).items():
        assert one.accel.of_peaks == pytest.approx(by_segment(expected)[name].accel.of_peaks, rel=0.01)


def test_curves_have_the_rms_of_both_parts() -> None:
    subject = with_spread(shipped("subject_1"), share=0.3, spread=1e-9)
    found, motion = estimated(subject), seat()
    accel = Chain.of(subject).simulate(motion, RATE_HZ).accel_mps2
    found.count_all()
    recent = list(found.recent)
    assert [one.begin_ns - EPOCH_NS for one in recent] == [second * 10**9 for second in range(7)]
    for second in (3, 5):
        part = slice(second * 1130, (second + 1) * 1130)
        np.testing.assert_allclose(recent[second].accel_mps2, 0.3 * accel[part].std(axis=0), rtol=0.15)


def test_a_stronger_motion_than_fitted_is_less_sure() -> None:
    """With stiffening known only within a factor, shocks are less sure than a smooth road."""
    subject = with_spread(shipped("subject_1"), share=1e-9)
    matrix = np.diag([1e-12] * 13 + [0.5**2])
    given = dict(subject.provenance)
    given["covariance"] = given["covariance"] | {"ln_theta": matrix.tolist()}
    subject = dataclasses.replace(subject, provenance=given)
    spread, _ = prediction_spread(subject)
    assert spread is not None
    widths = []
    for level in (0.1, 5.0):
        motion = level * seat()
        found = IntervalEstimator(spread, RATE_HZ, 60.0)
        found.push(block(motion, 0, motion.size, True), Chain.of(subject).simulate(motion, RATE_HZ).accel_mps2)
        widths.append(by_segment(found)["pelvis"].accel.of_peaks)
    assert widths[1] > 10.0 * widths[0]


@settings(max_examples=10)
@given(st.lists(st.integers(1, 9000), max_size=8).map(sorted).map(tuple))
def test_block_cuts_change_nothing(cuts: tuple[int, ...]) -> None:
    assert by_segment(estimated(cuts=cuts)) == by_segment(estimated())


def test_a_whole_run_counts_as_blocks_that_are_reset_after_its_warm_up() -> None:
    """The last second of a run counts; of blocks it waits for the next sample."""
    motion, begin = seat(8.1), round(2.0 * RATE_HZ)
    accel = Chain.of(SUBJECT).simulate(motion, RATE_HZ).accel_mps2
    spread, _ = prediction_spread(SUBJECT)
    assert spread is not None
    whole, blocks = IntervalEstimator(spread, RATE_HZ, 60.0), IntervalEstimator(spread, RATE_HZ, 60.0)
    end = round(8.0 * RATE_HZ)
    stamps_ns = block(motion, 0, end, True).stamps_ns + 123_456_789  # its seconds begin with its first counted sample
    whole.push_run(stamps_ns, motion[:end], accel[:end], begin)
    cut = begin + 10  # the second before it is complete
    blocks.push(block(motion, 0, cut, True), accel[:cut])
    blocks.reset()
    blocks.push(block(motion, cut, motion.size, False), accel[cut:])
    assert by_segment(whole) == by_segment(blocks)
    once = by_segment(whole)
    whole.push_run(stamps_ns, motion[:end], accel[:end], begin)  # another run of the same motion, from rest again
    for name, found in by_segment(whole).items():
        assert found.accel.of_vdv == pytest.approx(once[name].accel.of_vdv, rel=1e-9)


def test_a_neighbour_that_diverges_in_a_whole_run_begins_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Otherwise all later seconds would be missing in the spread of the whole run."""
    spread, _ = prediction_spread(SUBJECT)
    assert spread is not None
    motion = seat()
    accel = Chain.of(SUBJECT).simulate(motion, RATE_HZ).accel_mps2
    found = IntervalEstimator(spread, RATE_HZ, 60.0)
    neighbour = found._steppers[0]
    push, reset, past, diverged = neighbour.push, neighbour.reset, [0], [False]

    def push_diverging(seat_mps2: np.ndarray) -> np.ndarray:
        past[0] += seat_mps2.size
        diverged[0] |= past[0] - seat_mps2.size <= 3500 < past[0]
        return push(seat_mps2) * (np.nan if diverged[0] else 1.0)

    def reset_diverged() -> None:
        diverged[0] = False
        reset()

    monkeypatch.setattr(neighbour, "push", push_diverging)
    monkeypatch.setattr(neighbour, "reset", reset_diverged)
    stamps_ns = block(motion, 0, motion.size, True).stamps_ns
    found.push_run(stamps_ns, motion, accel, 0)
    counted = [one.begin_ns // 10**9 for one in found.recent]
    assert {0, 1, 5, 6, 7} <= set(counted) and 3 not in counted


def test_a_window_in_which_the_model_diverged_is_left_out() -> None:
    spread, _ = prediction_spread(SUBJECT)
    assert spread is not None
    motion = seat()
    accel = Chain.of(SUBJECT).simulate(motion, RATE_HZ).accel_mps2
    accel[3500:3600] = np.nan
    found = IntervalEstimator(spread, RATE_HZ, 60.0)
    found.push(block(motion, 0, motion.size, True), accel)
    found.count_all()
    assert [(one.begin_ns - EPOCH_NS) // 10**9 for one in found.recent] == [0, 1, 2, 4, 5, 6]
    assert np.isfinite(by_segment(found)["head"].accel.of_means)


def test_a_segment_without_a_law_takes_the_larger_share_beside_it() -> None:
    shares = {"pelvis": 0.1, "lower_torso": 0.2, "upper_torso": 0.4, "neck": 0.1}
    laws = {name: UsualResidual((0.01,) * N_BANDS, (share,) * N_BANDS, 50) for name, share in shares.items()}
    provenance = SUBJECT.provenance | {PROVENANCE: {name: law.to_dict() for name, law in laws.items()}}
    spread, _ = prediction_spread(dataclasses.replace(SUBJECT, provenance=provenance))
    assert spread is not None
    np.testing.assert_allclose(spread.share[0], [0.1, 0.2, 0.4, 0.4, 0.1, 0.1])


def test_carried_sums_what_is_above() -> None:
    np.testing.assert_array_equal(carried(np.arange(6.0)), [15.0, 15.0, 14.0, 12.0, 9.0, 5.0])


# --- the pipeline ----------------------------------------------------------------------------------------------------


def test_the_pipeline_has_the_spread_of_its_figures() -> None:
    streams = noisy_streams(seconds=6.0)
    found = run(streams, in_turn(streams), pipeline=Pipeline(SUBJECT))
    assert found.pipeline.no_interval == "" and tuple(found.exposure.spreads) == SEGMENTS
    assert all(0.03 < one.accel.of_means < 0.2 for one in found.exposure.spreads.values())
    again = run(streams, in_turn(streams, 37), pipeline=Pipeline(SUBJECT))
    assert again.exposure.spreads == found.exposure.spreads
    # Nothing else changes: the predictions are those of a subject without a spread.
    plain = run(streams, in_turn(streams), pipeline=Pipeline(shipped("subject_1")))
    np.testing.assert_array_equal(plain.predicted, found.predicted)
    assert plain.exposure.spreads == {} and "no covariance" in plain.pipeline.no_interval
    found.pipeline.reset()
    assert found.pipeline.exposure().spreads == {} and found.pipeline.exposure(rolling=True).spreads != {}


@pytest.mark.parametrize("uneven", [lambda s: quantised(s, 4), lambda s: in_bursts(s, 20, 0.1)])
def test_quantised_and_bursty_stamps_have_the_spread_of_even_ones(uneven: Callable[..., np.ndarray]) -> None:
    streams = noisy_streams(seconds=8.0)
    stamped = tuple(dataclasses.replace(one, stamps_ns=uneven(one.stamps_ns)) for one in streams)
    expected, found = (run(s, in_turn(s), pipeline=Pipeline(SUBJECT)).exposure.spreads for s in (streams, stamped))
    assert set(found) == set(SEGMENTS)
    for name, spread in found.items():
        assert spread.accel.of_means == pytest.approx(expected[name].accel.of_means, rel=0.02)
        assert spread.force.of_rms == pytest.approx(expected[name].force.of_rms, rel=0.02)


def test_losses_within_strong_motion_take_no_interval_away() -> None:
    streams = noisy_streams(seconds=8.0)
    kept = np.arange(len(streams[0].stamps_ns)) % 1350 >= 10  # 9 ms lost every 1.2 s
    seat = dataclasses.replace(streams[0], stamps_ns=streams[0].stamps_ns[kept], accel_mps2=streams[0].accel_mps2[kept])
    assert seat.sensor == "seat"
    expected, found = (run(s, in_turn(s), pipeline=Pipeline(SUBJECT)) for s in (streams, (seat, *streams[1:])))
    assert found.pipeline.predictor.suspect_s() > 0.3
    for name, spread in found.exposure.spreads.items():
        assert spread.accel.of_means == pytest.approx(expected.exposure.spreads[name].accel.of_means, rel=0.1)
    assert set(found.exposure.spreads) == set(SEGMENTS)


def test_without_a_positive_covariance_predictions_go_on_without_an_interval() -> None:
    given = dict(SUBJECT.provenance)
    given["covariance"] = {"names": list(given["covariance"]["names"]), "ln_theta": (-np.eye(14)).tolist()}
    streams = noisy_streams(seconds=6.0)
    found = run(streams, in_turn(streams), pipeline=Pipeline(dataclasses.replace(SUBJECT, provenance=given)))
    assert "is not positive" in found.pipeline.no_interval and found.exposure.spreads == {}
    assert np.isfinite(found.predicted).all() and found.pipeline.not_monitored == ""
