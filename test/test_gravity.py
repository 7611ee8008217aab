"""Gravity offline: rest anywhere in the record, the mean over motion, another record; all samples count."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import naive
import numpy as np
import pytest
from conditioned import RATE_HZ, START_NS, Conditioned, raw, stamps
from hypothesis import example, given, settings
from hypothesis import strategies as st
from streams import independent_streams, info, noisy_streams, subject, write_bag

from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import SENSORS
from biodyn_core.body.synthesis import ImuStream
from biodyn_core.conditioning.conditioning_settings import ConditioningSettings
from biodyn_core.conditioning.gravity import Gravity, from_other_record, gravity_in_rest
from biodyn_core.conditioning.gravity_search import GravitySearch
from biodyn_core.pipeline.pipeline_settings import PipelineSettings
from biodyn_ros.commands.cli import main
from biodyn_ros.fit.fitting import FitOptions, fit_bags
from biodyn_ros.reading.events import EventOptions, read_events
from biodyn_ros.reading.recordings import RecordingOptions, read_recordings
from biodyn_ros.replay.replaying import ReplayOptions, replay

G = naive.GRAVITY


def swaying(seconds: float, size: float = 3.0, seed: int = 0, still: tuple[float, float] | None = None) -> np.ndarray:
    """Specific force (n, 3), up last, that sways about gravity, but for the seconds in which it is still."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    sway = sum(np.sin(2.0 * np.pi * f * time + rng.uniform(0, 6.3)) for f in (2.3, 4.1, 7.9))[:, None]
    if still is not None:
        sway = np.where((time >= still[0]) & (time < still[1]), 0.0, sway.T).T
    return size * sway * [0.2, 0.3, 1.0] + [0.0, 0.0, G] + 0.01 * rng.standard_normal((time.size, 3))


def searched(samples: np.ndarray, cuts=(), stamps_ns=None, **settings_: float) -> Gravity | None:
    """The result of a search of the record."""
    search = GravitySearch(ConditioningSettings(**settings_))
    stamps_ns = stamps(len(samples)) if stamps_ns is None else stamps_ns
    for part in zip(np.split(stamps_ns, cuts), np.split(samples, cuts), strict=True):
        search.push(*part)
    return search.result()


# --- where gravity comes from ----------------------------------------------------------------------------------------


def test_rest_at_the_begin_is_left_to_conditioning():
    samples = swaying(6.0, still=(0.0, 1.0))
    assert searched(samples).origin == "begin"
    known = Conditioned(stamps(len(samples)), samples, gravity=searched(samples))
    plain = Conditioned(stamps(len(samples)), samples)
    np.testing.assert_array_equal(known.low_passed, plain.low_passed)
    assert known.status == plain.status


@pytest.mark.parametrize("begin_s", [0.3, 2.05, 5.0])
def test_rest_is_found_anywhere(begin_s):
    samples = swaying(6.2, still=(begin_s, begin_s + 1.2))
    found = searched(samples)
    first, end = found.samples
    assert found.origin == "rest" and begin_s - 0.2 <= found.at_s <= begin_s + 0.4
    assert (end - first) / RATE_HZ == pytest.approx(0.8, abs=0.01)
    np.testing.assert_allclose(found.mean_mps2, samples[first:end].mean(axis=0), rtol=1e-12)
    assert "no rest at the start: gravity is from the rest at" in found.warning(vertical_given=False)


@pytest.mark.parametrize("stray_s", [-1e9, -3600.0, -30.0, 3600.0])
@pytest.mark.parametrize("count", [1, 3])
def test_stray_first_stamps_move_no_rest(stray_s, count):
    samples, stamps_ns = swaying(6.2, still=(2.0, 3.2)), stamps(round(6.2 * RATE_HZ))
    stamps_ns[:count] += round(1e9 * stray_s)
    found = searched(samples, stamps_ns=stamps_ns)
    assert found.origin == "rest" and 1.8 <= found.at_s <= 2.4


@pytest.mark.parametrize("reading", [(0.0, 0.0, -9.8), (9.0, 2.0, 4.0), (0.0, 1.5, 10.5), (0.0, 0.0, 0.0)])
@pytest.mark.parametrize("rest_at_s", [None, 12.5])
@pytest.mark.parametrize("begin_s", [0.0, 3.0])
def test_a_sensor_that_repeats_one_reading_is_at_rest_only_without_another_rest(reading, rest_at_s, begin_s):
    """The same reading for 8 s, as after a fault, from the begin or later: neither rest nor part of the motion."""
    samples = swaying(16.0, still=None if rest_at_s is None else (rest_at_s, rest_at_s + 1.2))
    samples[round(begin_s * RATE_HZ) : round((begin_s + 8.0) * RATE_HZ)] = reading
    found = searched(samples)
    if rest_at_s is not None:
        assert found.origin == "rest" and found.at_s == pytest.approx(rest_at_s, abs=0.4) and not found.is_constant
        np.testing.assert_allclose(found.mean_mps2, [0.0, 0.0, G], atol=0.1)
    elif found.is_constant:  # as mounted, or where conditioning begins
        assert found.mean_mps2 == pytest.approx(reading) and (reading[2] > 10.0 or begin_s == 0.0)
        assert "repeats one reading: is it stuck?" in found.warning(vertical_given=False)
    else:
        assert found.origin == "motion"
        np.testing.assert_allclose(found.mean_mps2, [0.0, 0.0, G], atol=0.6)  # a part at the edge has both


def test_a_coarse_sensor_is_at_rest_where_it_repeats_one_reading():
    """Steps of 0.3 m/s^2, which hide the noise."""
    samples = np.round(swaying(8.0, still=(3.0, 4.5)) / 0.3) * 0.3
    found = searched(samples)
    assert found.origin == "rest" and found.is_constant and found.at_s == pytest.approx(3.1, abs=0.3)


def coarse_ride(stop: bool) -> np.ndarray:
    """Steps of 0.3 m/s^2, larger than the noise: 10 s at rest, 10 s in which speed is gathered smoothly, and a stop."""
    samples = swaying(30.0, still=(0.0, 30.0) if stop else (0.0, 20.0))
    gathers = slice(round(10.0 * RATE_HZ), round(20.0 * RATE_HZ))
    ramp = np.minimum(1.0, np.arange(gathers.stop - gathers.start) / (2.0 * RATE_HZ))
    samples[gathers] += np.outer(ramp, [1.35, 0.0, 0.0])
    return np.round(samples / 0.3) * 0.3


def test_a_coarse_sensor_that_returns_to_its_reading_after_motion_is_at_rest():
    """A smooth acceleration shows noise, and is no rest all the same."""
    samples = coarse_ride(stop=True)
    found = searched(samples)
    assert found.origin == "begin" and not found.is_constant and found.warning(vertical_given=False) is None
    np.testing.assert_allclose(found.mean_mps2, samples[0], atol=1e-9)


def test_a_rest_beside_a_stuck_begin_says_so():
    found = searched(coarse_ride(stop=False))
    assert found.origin == "rest" and found.stuck_at_s == 0.0
    line = found.warning(vertical_given=False)
    assert line.startswith("gravity is from the rest at 1") and "from 0.0 s on it repeats another reading" in line


def test_a_reading_that_is_sent_again_is_no_rest_against_one_with_noise_nearer_to_the_motion():
    """A driver that sends a default reading in its time-outs."""
    samples = swaying(40.0, still=(25.0, 30.0))
    samples += [1.5, 0.0, -0.1]
    for begin_s in (0.0, 12.0):
        samples[round(begin_s * RATE_HZ) : round((begin_s + 2.0) * RATE_HZ)] = (0.0, 0.0, G)
    found = searched(samples)
    np.testing.assert_allclose(found.mean_mps2, (1.5, 0.0, G - 0.1), atol=0.02)
    assert "from 0.0 s on it repeats another reading: was it stuck?" in found.warning(vertical_given=False)


@pytest.mark.parametrize("apart_mps2", [0.3, 0.5, 0.7, 0.9])
def test_a_true_rest_after_a_stuck_reading_is_found_by_its_return(apart_mps2):
    """A coarse sensor: a default reading for 2.5 s, then its own, motion, and a stop with its own reading again."""
    samples = np.round(swaying(20.0, still=(0.0, 6.0)) / 0.1) * 0.1
    own = (apart_mps2, 0.0, 9.8)
    for begin_s, end_s, reading in ((0.0, 2.5, (0.0, 0.0, 9.8)), (2.5, 6.0, own), (14.0, 20.0, own)):
        samples[round(begin_s * RATE_HZ) : round(end_s * RATE_HZ)] = reading
    found = searched(samples)
    np.testing.assert_allclose(found.mean_mps2, own, atol=1e-6)
    assert "from 0.0 s on it repeats another reading: was it stuck?" in found.warning(vertical_given=False)


def test_noise_that_begins_after_a_repeated_reading_is_the_same_rest():
    samples = swaying(8.0, still=(0.0, 4.0))
    samples[: round(2.0 * RATE_HZ)] = (0.0, 0.0, G)
    found = searched(samples)
    assert found.origin == "begin" and found.warning(vertical_given=False) is None


@pytest.mark.parametrize(("reading", "is_right"), [((1.2, 0.4, 9.8), False), ((0.3, 0.1, 9.8), True)])
def test_a_reading_that_is_repeated_amid_motion_must_agree_with_the_mean_over_motion(reading, is_right):
    samples = swaying(12.0)
    samples[round(4.0 * RATE_HZ) : round(5.5 * RATE_HZ)] = reading
    found = searched(samples)
    assert (found.origin == "rest" and found.is_constant) == is_right
    if not is_right:
        assert found.origin == "motion" and not found.tilted and found.stuck_at_s == pytest.approx(4.1, abs=0.2)
        assert "on it repeats another reading: was it stuck?" in found.warning(vertical_given=False)


def test_a_single_glitch_of_a_stuck_sensor_is_no_motion():
    samples = swaying(12.0, still=None)
    samples[: round(6.0 * RATE_HZ)] = (1.2, 0.4, 9.8)
    samples[round(3.0 * RATE_HZ)] += 5.0
    assert searched(samples).is_constant


def test_another_record_lends_a_repeated_reading_only_without_another_rest():
    own = Gravity((1.0, 2.0, 9.5), "motion")
    stuck = Gravity((1.1, 2.0, 9.5), "begin", is_constant=True)
    still = Gravity((1.2, 2.1, 9.4), "rest", 3.0)
    lent = from_other_record(own, [("a.mcap", stuck), ("b.mcap", still)])
    assert (lent.source, lent.is_constant) == ("b.mcap", False)
    lent = from_other_record(own, [("a.mcap", stuck)])
    assert lent.mean_mps2 == stuck.mean_mps2
    assert lent.warning(False) == "gravity is from 0.0 s on in a.mcap, where it repeats one reading: is it stuck?"


@pytest.mark.parametrize("share", [0.0, 0.4, 0.7])
def test_gravity_in_a_rest_leaves_out_the_part_in_which_the_sensor_is_stuck(share):
    samples = swaying(10.0, still=(0.0, 10.0))
    samples[: round(share * len(samples))] = (1.6, 0.4, 9.6)
    found = gravity_in_rest(samples, np.full(samples.shape, np.nan))
    np.testing.assert_allclose(found.mean_mps2, [0.0, 0.0, G], atol=1e-3)


def test_gravity_in_a_rest_keeps_what_a_coarse_sensor_repeats_and_needs_a_change():
    coarse = np.round(swaying(10.0, still=(0.0, 10.0)) / 0.1) * 0.1
    coarse[::500] += 0.1
    np.testing.assert_allclose(gravity_in_rest(coarse, coarse * np.nan).mean_mps2, coarse.mean(axis=0), rtol=1e-12)
    assert gravity_in_rest(np.tile([0.0, 0.0, G], (5000, 1)), np.full((5000, 3), np.nan)) is None
    assert gravity_in_rest(np.tile([0.0, 0.0, G], (80, 1)), np.full((80, 3), np.nan)) is None


@pytest.mark.parametrize(
    "others", [np.tile([3.0, 2.0, 9.0], (1, 1)), np.linspace([1.0, 0.0, 9.7], [1.1, 0.0, 9.7], 900)]
)
def test_few_other_readings_are_no_rest_beside_a_repeated_one(others):
    """A spike, and a lean for the first second of 20 s: neither is gravity."""
    samples = np.vstack([others, np.tile([0.0, 0.0, G], (20_000, 1))])
    assert gravity_in_rest(samples, np.full(samples.shape, np.nan)) is None


def test_without_rest_the_mean_over_motion_is_used_with_a_remedy():
    samples = swaying(6.0)
    found = searched(samples)
    assert found.origin == "motion"
    np.testing.assert_allclose(found.mean_mps2, samples.mean(axis=0), rtol=1e-12)
    message = found.warning(vertical_given=False)
    assert (
        message == "no rest in the record: gravity is the mean over motion; the parameter vertical gives the direction"
    )
    assert found.warning(vertical_given=True) == "no rest in the record: the length of gravity is the mean over motion"
    # Over an engine that idles there is another option, and it helps.
    idle = searched(swaying(6.0, size=0.4))
    assert idle.origin == "motion" and f"set rest_rms_mps2 above {idle.quietest_mps2:.3f}" in idle.warning(False)
    assert searched(swaying(6.0, size=0.4), rest_rms_mps2=1.01 * idle.quietest_mps2).is_rest


@pytest.mark.parametrize("table_s", [2.0, 30.0])
@pytest.mark.parametrize("before", [False, True])
def test_rest_on_a_table_is_not_used(table_s, before):
    ride, table = swaying(8.0, still=None), swaying(table_s, still=(0.0, table_s))[:, [1, 2, 0]]
    # Taken in the hand first, so that the record does not begin at rest.
    samples = np.concatenate([swaying(1.0)[:, [2, 0, 1]], table, ride] if before else [ride, table])
    found = searched(samples)
    assert found.origin == "motion" and found.tilted
    assert np.degrees(np.arccos(found.mean_mps2[2] / np.linalg.norm(found.mean_mps2))) < (10.0 if before else 1.0)
    assert "rests only where it is tilted by more than 30 deg" in found.warning(vertical_given=False)
    # Rest in the ride's own mounting is taken, wherever it lies.
    own = np.concatenate([samples, swaying(1.5, still=(0.0, 1.5))])
    assert searched(own).origin == "rest" and searched(own).mean_mps2[2] == pytest.approx(G, abs=0.01)


def test_zeros_of_a_sensor_that_starts_late_are_no_rest():
    samples = np.concatenate([np.zeros((2000, 3)), swaying(6.0, still=(3.0, 4.5))])
    found = searched(samples)
    assert found.origin == "rest" and found.samples[0] > 2000 + 2.7 * RATE_HZ


@pytest.mark.parametrize(("samples", "stamp_ns"), [(500, None), (3000, 7)])
def test_faulty_records_are_left_to_conditioning(samples, stamp_ns):
    # Shorter than rest_s, and stamps that stand still.
    readings = swaying(samples / RATE_HZ)
    stamps_ns = None if stamp_ns is None else np.full(len(readings), START_NS)
    assert searched(readings, stamps_ns=stamps_ns) is None


@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1), st.lists(st.integers(1, 6000), max_size=6), st.floats(0.0, 5.0), st.booleans())
def test_any_cut_finds_the_same(seed, cuts, begin_s, rests):
    samples = swaying(5.5, seed=seed % 7, still=(begin_s, begin_s + 1.1) if rests else None)
    rng = np.random.default_rng(seed)
    keep = np.sort(rng.choice(len(samples), len(samples) - rng.integers(0, 400), replace=False))
    stamps_ns = stamps(len(samples))[keep]
    cuts = sorted(min(cut, len(keep)) for cut in cuts)
    assert searched(samples[keep], cuts, stamps_ns) == searched(samples[keep], (), stamps_ns)


def test_no_window_at_rest_spans_a_gap():
    # Two quiet ends of 0.5 s around a gap of an hour are no 0.8 s of rest.
    samples = np.concatenate([swaying(3.0, still=(2.5, 3.0)), swaying(3.0, seed=1, still=(0.0, 0.5))])
    stamps_ns = stamps(len(samples))
    stamps_ns[len(samples) // 2 :] += 3600 * 10**9
    assert searched(samples, stamps_ns=stamps_ns).origin == "motion"


def tilted(mean: np.ndarray, deg: float) -> tuple[float, float, float]:
    turn = np.radians(deg)
    return tuple(np.array([[1, 0, 0], [0, np.cos(turn), -np.sin(turn)], [0, np.sin(turn), np.cos(turn)]]) @ mean)


@pytest.mark.parametrize(("deg", "alike"), [(3.0, True), (8.0, False)])
def test_rest_of_another_record_is_used_for_the_same_mounting(deg, alike):
    own = Gravity((0.0, 0.0, G), "motion")
    other = Gravity(tilted(np.array([0.0, 0.0, G]), deg), "rest")
    far = Gravity(tilted(np.array([0.0, 0.0, G]), deg + 1.0), "begin")
    found = from_other_record(own, [("far.mcap", far), ("other.mcap", other), ("own.mcap", own)])
    assert (found.mean_mps2 == other.mean_mps2) is alike
    assert (found.origin, found.source) == (("other_record", "other.mcap") if alike else ("motion", ""))
    assert from_other_record(other, [("far.mcap", far)]) is other


# --- conditioning with known gravity ---------------------------------------------------------------------------------


def test_conditioning_begins_at_the_first_sample():
    samples = swaying(4.0, still=(2.5, 3.5))
    known = searched(samples)
    found = Conditioned(stamps(len(samples)), samples, gravity=known)
    np.testing.assert_allclose(found.levelled[:, 2], samples[:, 2] - known.mean_mps2[2], atol=2e-3)
    assert len(found.levelled) == len(samples)
    assert (found.status.uncounted_s, found.status.unrested_s, found.status.runs) == (0.0, 0.0, 1)
    assert found.conditioner.first_ns == START_NS
    assert any("gravity is from the rest at 2." in line for line in found.status.warnings)


def test_unusable_samples_at_the_begin_shift_no_clock():
    samples = swaying(4.0)
    samples[:20] = np.nan
    found = Conditioned(stamps(len(samples)), samples, gravity=Gravity((0.0, 0.0, G), "motion"))
    assert np.isfinite(found.low_passed).all() and found.status.filled == 0
    # Even stamps: every sample lies at its own stamp, from the first one.
    at = (found.stamps_ns - START_NS) * 1e-9 + found.conditioner.delay_s
    np.testing.assert_allclose(at, np.arange(20, len(samples)) / RATE_HZ, atol=1e-6)
    np.testing.assert_allclose(np.diff(found.time_s), 1.0 / RATE_HZ, rtol=1e-3)


def test_samples_before_a_gap_count_too_once_they_are_longer_than_rest():
    samples = swaying(5.0)
    stamps_ns = stamps(len(samples))
    stamps_ns[3000:] += 10**9
    found = Conditioned(stamps_ns, samples, gravity=searched(samples))
    assert len(found.levelled) == len(samples) and found.status.runs == 2
    assert found.status.gap_s == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("back_s", [0.16, 0.68, 0.95])
@pytest.mark.parametrize("at_s", [1.2, 8.37])
@pytest.mark.parametrize("is_known", [True, False])
def test_a_clock_that_is_set_back_does_not_falsify_the_rate(back_s, at_s, is_known):
    samples = swaying(25.0)
    stamps_ns = stamps(len(samples))
    stamps_ns[round(at_s * RATE_HZ) :] -= round(back_s * 1e9)
    status = Conditioned(stamps_ns, samples, gravity=searched(samples) if is_known else None).status
    assert status.rate_hz == pytest.approx(RATE_HZ, rel=1e-6) and status.filled == 0
    # The stamps of that time repeat: these samples are late, and their time is missing; live, waiting restarts.
    assert status.set_back_s == pytest.approx(back_s if is_known else 0.0, abs=0.01)
    assert status.uncounted_s == pytest.approx(0.0 if is_known else at_s + 10.4, abs=0.4)


@settings(max_examples=15)
@example([3671], "causal", 6.5, False, 200_000_000)
@given(
    st.lists(st.integers(0, 17_000), max_size=6), st.sampled_from(["causal", "zero_phase"]), st.floats(1.0, 14.0),
    st.booleans(), st.sampled_from([200_000_000, -200_000_000]),
)  # fmt: skip
def test_any_cut_gives_the_same_with_known_gravity(cuts, mode, seconds, unset, step_ns):
    samples = swaying(seconds)
    stamps_ns = stamps(len(samples))
    stamps_ns[len(samples) // 2 :] += step_ns
    if unset:
        stamps_ns[7::501] = 0
    known = Gravity((0.0, 0.0, G), "motion", samples=(0, len(samples)))
    cuts = sorted(min(cut, len(samples)) for cut in cuts)
    whole = Conditioned(stamps_ns, samples, mode=mode, gravity=known)
    cut = Conditioned(stamps_ns, samples, cuts, mode=mode, gravity=known)
    for name in ("stamps_ns", "time_s", "levelled", "low_passed", "begins"):
        np.testing.assert_array_equal(getattr(cut, name), getattr(whole, name), err_msg=name)
    assert cut.status == whole.status


# --- replay: nothing is lost -----------------------------------------------------------------------------------------


def idling(seconds: float = 14.0, shock_s: float = 5.0) -> np.ndarray:
    """Vertical of a seat over an engine that idles with 0.4 m/s^2 rms, and a half-sine of 30 m/s^2, 50 ms, early on."""
    time = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    shock = np.where(np.abs(time - shock_s) < 0.025, 30.0 * np.cos(np.pi * (time - shock_s) / 0.05), 0.0)
    return 0.4 * np.sqrt(2.0) * np.sin(2.0 * np.pi * 25.0 * time) + shock


@pytest.fixture(scope="module")
def idle_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All six sensors on the seat's motion, which never rests."""
    samples = raw(idling()[:, None] * [0.0, 0.0, 1.0])
    streams = [ImuStream(name, stamps(len(samples)), samples, np.zeros_like(samples)) for name in SENSORS]
    return write_bag(tmp_path_factory.mktemp("idle") / "idle.mcap", streams)


@pytest.mark.parametrize("vertical", ["", "seat=0,0,1"])
def test_a_shock_before_any_rest_is_counted(idle_bag: Path, vertical: str) -> None:
    options = ReplayOptions(pipeline=PipelineSettings(vertical=vertical))
    document = replay(idle_bag, subject(), options).document
    truth = naive.weighted("Wk", idling(), RATE_HZ)
    vdv = (np.sum(truth**4) / RATE_HZ) ** 0.25
    assert vdv > 5.0  # without the shock it is 0.9
    assert document["uncounted_s"] == 0.0
    assert document["sensors"]["seat"]["vdv_mps175"] == pytest.approx(vdv, rel=2e-3)
    assert not document["sensors"]["seat"]["lower_bound"]
    (message,) = (line for line in document["warnings"] if line.startswith("seat: no rest in the record"))
    assert "set rest_rms_mps2 above 0.4" in message
    assert ("the parameter vertical gives the direction" in message) is not bool(vertical)


@pytest.mark.parametrize("sensor", ["head", "seat"])
def test_a_sensor_with_its_rest_elsewhere_is_compared_from_the_start(tmp_path: Path, sensor: str) -> None:
    """It is moved in the first second, so that its clock is known after ten seconds; the others rest at the start."""
    rng = np.random.default_rng(0)
    streams = []
    for one in noisy_streams(12.0):
        accel = one.accel_mps2.copy()
        if one.sensor == sensor:
            accel[: round(RATE_HZ)] += rng.normal(0.0, 2.0, (round(RATE_HZ), 3))
        streams.append(dataclasses.replace(one, accel_mps2=accel))
    document = replay(write_bag(tmp_path / "moved.mcap", streams), subject()).document
    assert any(line.startswith(f"{sensor}: no rest at the start") for line in document["warnings"])
    whole = replay(write_bag(tmp_path / "plain.mcap", noisy_streams(12.0)), subject()).document
    for name, figures in whole["measured_low_passed"].items():
        found = document["measured_low_passed"][name]["vdv_mps175"] / figures["vdv_mps175"]
        # A seat that begins in strong motion leaves out the restart of its weighting.
        assert found == pytest.approx(1.0, rel=1e-3) if sensor == "head" else 0.98 < found < 1.0
        assert document["measured_low_passed"][name]["missing_s"] < 1.0


def test_the_uncounted_time_is_that_of_the_seat(tmp_path: Path) -> None:
    """Here the other sensors are at rest at the beginning, which is not counted, and the seat is at rest later."""
    seat, *others = independent_streams(4.0)
    shaken = seat.accel_mps2.copy()
    shaken[: round(1.1 * RATE_HZ)] += np.random.default_rng(0).normal(0.0, 2.0, (round(1.1 * RATE_HZ), 3))
    streams = [dataclasses.replace(seat, accel_mps2=shaken), *others]
    found = replay(write_bag(tmp_path / "seat.mcap", streams), subject())
    assert streams[0].sensor == "seat" and found.pipeline.status("head").uncounted_s > 0.5
    assert found.document["uncounted_s"] == found.pipeline.status("seat").uncounted_s == 0.0


def test_info_reports_the_gravity_that_replay_uses(idle_bag: Path) -> None:
    document = info(idle_bag)
    assert document["topics"][0]["gravity_mps2"] == pytest.approx(G + idling().mean(), abs=1e-3)
    assert document["replay"]["refusal"] is None and document["replay"]["sensors"] == list(SENSORS)
    assert any(line.startswith("seat: no rest in the record") for line in document["warnings"])


# --- fit and trace leave out unusable recordings ----------------------------------------------------------------------


def part(stream: ImuStream, begin_s: float, end_s: float) -> ImuStream:
    cut = slice(round(begin_s * RATE_HZ), round(end_s * RATE_HZ))
    return dataclasses.replace(
        stream, stamps_ns=stream.stamps_ns[cut], accel_mps2=stream.accel_mps2[cut], gyro_radps=stream.gyro_radps[cut]
    )


@pytest.fixture(scope="module")
def short_bags(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """One ride with rest, six seconds of motion alone, one second, and one that does not move."""
    folder, ride = tmp_path_factory.mktemp("short"), independent_streams(9.0)
    still = [dataclasses.replace(each, accel_mps2=np.tile([0.0, 0.0, G], (len(each.stamps_ns), 1))) for each in ride]
    written = {
        "road_whole": ride,
        "road_moving": [part(each, 2.5, 8.5) for each in ride],
        "road_second": [part(each, 3.0, 4.0) for each in ride],
        "road_still": still,
    }
    return {name: write_bag(folder / f"{name}.mcap", streams) for name, streams in written.items()}


def test_a_recording_without_rest_is_read(short_bags: dict[str, Path]) -> None:
    (found,) = read_recordings(short_bags["road_moving"])
    (whole,) = read_recordings(short_bags["road_whole"])
    assert found.stamps_ns.size / found.rate_hz == pytest.approx(6.0, abs=0.1)
    assert any("seat: no rest in the record" in line for line in found.warnings)
    shared, here, there = np.intersect1d(found.stamps_ns, whole.stamps_ns, return_indices=True)
    inner = slice(round(1.0 * RATE_HZ), shared.size - round(1.0 * RATE_HZ))
    np.testing.assert_allclose(found.seat_mps2[here][inner], whole.seat_mps2[there][inner], atol=0.1)


def events(bags: list[Path], held_out: list[Path] | None = None):
    options = EventOptions({}, RecordingOptions(), FitOptions().spectra, FitOptions().preparing)
    return read_events(bags, [str(bag) for bag in held_out or []], options, lambda done, total: None)


def test_events_that_cannot_be_used_are_left_out_by_name(short_bags: dict[str, Path]) -> None:
    found = events(list(short_bags.values()))
    assert [Path(event.bag).stem for event, _ in found.prepared] == ["road_whole", "road_moving"]
    assert [line.split(".mcap")[0].rsplit("/")[-1] for line in found.left_out] == ["road_second", "road_still"]
    assert "are too short" in found.left_out[0] and "without excitation" in found.left_out[1]
    lent = found.prepared[1][1].warnings
    # This seat has no noise at rest.
    assert any("seat: gravity is from 0.0 s on in road_whole.mcap, where it repeats one" in line for line in lent)


def test_a_fit_leaves_out_recordings_and_stops_only_without_any(
    short_bags: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bad = [short_bags["road_second"], short_bags["road_still"]]
    with pytest.raises(InputError, match=r"none of the 2 bags can be fitted; the first: .*road_second.* too short"):
        fit_bags(bad, subject())
    with pytest.raises(InputError, match="road_still"):
        fit_bags(bad[1:], subject())
    # A held-out event alone is nothing to fit to.
    with pytest.raises(InputError, match="none of the 2 bags"):
        events(bad, [short_bags["road_whole"]])
    assert main(["trace", *map(str, bad), "--subject", "subject_1", "-o", str(tmp_path / "out")]) == 2
    refused = capsys.readouterr().err.strip().splitlines()[-1]
    assert refused.startswith("biodyn trace: none of the 2 bags can be fitted") and not (tmp_path / "out").exists()
    # A path that is wrong is an error, not an event to leave out.
    assert main(["fit", str(short_bags["road_whole"]), "nowhere.mcap", "--subject", "subject_1", "-o", "x.yaml"]) == 2
    assert "nowhere.mcap" in capsys.readouterr().err


def test_a_trace_reports_the_recordings_it_leaves_out(short_bags: dict[str, Path], tmp_path: Path) -> None:
    bags = [str(short_bags[name]) for name in ("road_whole", "road_second")]
    assert (
        main(
            ["trace", *bags, "--subject", "subject_1", "-o", str(tmp_path / "out"), "--no-report", "--executor", "none"]
        )
        == 0
    )
    document = json.loads((tmp_path / "out" / "trace.json").read_text())
    assert any(line.startswith("left out: ") and "road_second" in line for line in document["warnings"])


def test_gravity_from_rest_at_the_start_has_no_warning() -> None:
    assert Gravity((0.0, 0.0, 9.8), "begin").warning(vertical_given=False) is None


def test_a_record_without_usable_samples_has_no_gravity() -> None:
    search = GravitySearch()
    search.push(np.array([1, 2], dtype=np.int64), np.full((2, 3), np.nan))
    assert search.result() is None
