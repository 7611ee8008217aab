"""Recordings: conditioned and masked samples against streams with known truth."""

from __future__ import annotations

import dataclasses
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import signal
from streams import RATE_HZ, START_NS, independent_streams, noisy_streams, subject

from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import MEASURED_SEGMENT_INDEX, MEASURED_SEGMENTS, SENSORS, STANDARD_GRAVITY_MPS2
from biodyn_core.base.wording import counted
from biodyn_core.body.model import Chain
from biodyn_core.body.synthesis import ImuStream, SensorSettings, load_case
from biodyn_core.conditioning.conditioner import ConditioningSettings
from biodyn_core.conditioning.low_pass import reach
from biodyn_core.identification.problem import Case
from biodyn_core.recording.body_sensor import REACH_SHARE
from biodyn_core.recording.flags import around, stretches
from biodyn_core.recording.recording import (
    WARM_UP_S,
    Recorder,
    Recording,
    RecordingSettings,
    level_mps2,
    representative,
)
from biodyn_ros.reading.provenance import MADE_BY_MODEL
from biodyn_ros.reading.recordings import RecordingOptions, case_of, read_recordings
from biodyn_ros.simulate import simulate_bag

HEAD = MEASURED_SEGMENTS.index("head")
REACH = 34
"""Reach of the low-pass to either side: ln 1000 over the decay of its slowest pole, 0.2045 per sample for 100 Hz."""


def recorded(streams, **settings) -> list[Recording]:
    """Streams through a Recorder, each pushed as one block."""
    recorder = Recorder("pothole", "drive", settings=RecordingSettings(**settings))
    for stream in streams:
        recorder.push(stream.sensor, stream.stamps_ns, stream.accel_mps2)
    return recorder.finish()


def one(streams, **settings) -> Recording:
    (recording,) = recorded(streams, **settings)
    return recording


def changed(streams, sensor: str, change) -> list[ImuStream]:
    """The streams, one sensor's (stamps, samples) put through `change`."""

    def with_change(stream: ImuStream) -> ImuStream:
        stamps, samples = change(stream.stamps_ns.copy(), stream.accel_mps2.copy())
        return dataclasses.replace(stream, stamps_ns=stamps, accel_mps2=samples, gyro_radps=np.zeros_like(samples))

    return [with_change(stream) if stream.sensor == sensor else stream for stream in streams]


def without(*lost: slice):
    """A change that loses these samples."""

    def lose(stamps, samples):
        rows = np.concatenate([np.arange(len(stamps))[part] for part in lost])
        return np.delete(stamps, rows), np.delete(samples, rows, axis=0)

    return lose


def masked_s(recording: Recording, sensor: str) -> float:
    """Seconds without a number."""
    return np.isnan(recording.measured_mps2[:, MEASURED_SEGMENTS.index(sensor)]).sum() / recording.rate_hz


# --- the numbers -----------------------------------------------------------------------------------------------------


def test_perfect_sensors_give_the_motion_of_another_integrator():
    recording = one(independent_streams(6.0))
    behind = round(WARM_UP_S * recording.rate_hz)
    predicted = Chain.of(subject()).simulate(recording.seat_mps2, recording.rate_hz).accel_mps2
    measured = recording.measured_mps2[behind:]
    error = predicted[behind:, MEASURED_SEGMENT_INDEX] - measured
    share = np.sqrt(np.nanmean(error**2, axis=0) / np.nanmean(measured**2, axis=0))
    # The seat taken as linear between samples errs by 2 (pi f / rate)^2 / 3: 1.0e-4 at 4.1 and 4.5e-4 at 9.3 Hz.
    assert share.max() < 2e-4
    assert recording.warnings == ()
    assert recording.rate_hz == pytest.approx(RATE_HZ, rel=1e-9)
    assert np.isfinite(recording.seat_mps2).all()


def test_sensor_errors_leave_the_rate_and_every_segment():
    recording = one(noisy_streams(4.0))
    assert recording.rate_hz == pytest.approx(RATE_HZ, rel=100e-6)
    assert recording.case == "pothole"
    assert recording.name == "drive"
    assert np.isfinite(recording.measured_mps2[50:-50]).all()
    assert (np.diff(recording.stamps_ns) > 0).all()


@pytest.mark.parametrize("seed", range(3))
def test_block_cuts_and_interleaving_never_change_a_bit(seed):
    streams = noisy_streams(3.0)
    streams = changed(streams, "head", without(slice(2000, 2020), slice(2500, 2502)))
    streams = changed(streams, "seat", clip_at(3000))
    whole = one(streams)
    rng = np.random.default_rng(seed)
    queues = {}
    for stream in streams:
        cuts = [0, *sorted(rng.choice(len(stream.stamps_ns), 20, replace=False).tolist()), len(stream.stamps_ns)]
        queues[stream.sensor] = [(stream, slice(*ends)) for ends in pairwise(cuts)]
    recorder = Recorder("pothole", "drive")
    while waiting := [
        name for name, queue in queues.items() if queue
    ]:  # in order within a sensor, in none between them
        stream, part = queues[str(rng.choice(waiting))].pop(0)
        recorder.push(stream.sensor, stream.stamps_ns[part], stream.accel_mps2[part])
    (cut,) = recorder.finish()
    assert cut.warnings == whole.warnings
    assert cut.rate_hz == whole.rate_hz
    np.testing.assert_array_equal(cut.stamps_ns, whole.stamps_ns)
    np.testing.assert_array_equal(cut.seat_mps2, whole.seat_mps2)
    np.testing.assert_array_equal(cut.measured_mps2, whole.measured_mps2)


# --- masks -----------------------------------------------------------------------------------------------------------


def clip_at(row: int, count: int = 3):
    """A change that puts a sensor's third axis at the end of its range."""

    def clip(stamps, samples):
        samples[row : row + count, 2] = 16.0 * STANDARD_GRAVITY_MPS2
        return stamps, samples

    return clip


def test_a_clipped_sample_is_masked_as_far_as_the_low_pass_reaches():
    streams, row = independent_streams(6.0), 4000
    good = one(streams, keep_level=True)
    recording = one(changed(streams, "head", clip_at(row)), keep_level=True)
    at = int(np.searchsorted(recording.stamps_ns, streams[0].stamps_ns[row]))
    head = recording.measured_mps2[:, HEAD]
    inside = np.isnan(head[at - REACH - 10 : at + REACH + 13])
    assert np.isnan(head[at - REACH : at + 3 + REACH]).all()
    assert 2 * REACH + 3 <= inside.sum() <= 2 * REACH + 3 + 12  # interpolation between samples adds its neighbours
    # The remainder of the three wrong samples elsewhere is below 0.1 % of them.
    wrong = 3 * 16.0 * STANDARD_GRAVITY_MPS2
    np.testing.assert_allclose(head, np.where(np.isnan(head), head, good.measured_mps2[:, HEAD]), atol=1e-3 * wrong)
    others = [k for k in range(5) if k != HEAD]
    np.testing.assert_array_equal(recording.measured_mps2[:, others], good.measured_mps2[:, others])
    assert "head: 3 samples clipped, masked" in recording.warnings
    assert any(line.startswith("head: nothing usable in 0.06 s of") for line in recording.warnings)


@pytest.mark.parametrize(
    ("rate_hz", "samples"), [(250.0, 31), (300.0, 21), (400.0, 18), (500.0, 19), (RATE_HZ, REACH), (4000.0, 116)]
)
def test_the_low_pass_reaches_no_further_than_stated(rate_hz, samples):
    # Near the lowest rate the digital filter decays more slowly than the analog one.
    sos = signal.butter(4, 100.0, fs=rate_hz, output="sos")
    assert reach(sos, REACH_SHARE) == samples
    impulse = np.zeros(4001)
    impulse[2000] = 1.0
    answer = np.abs(signal.sosfiltfilt(sos, impulse))
    assert answer[: 2000 - samples].max() < REACH_SHARE * answer.max()


def thinned(stream: ImuStream, step: int) -> ImuStream:
    stamps, samples, rates = (part[::step] for part in (stream.stamps_ns, stream.accel_mps2, stream.gyro_radps))
    return dataclasses.replace(stream, stamps_ns=stamps, accel_mps2=samples, gyro_radps=rates)


def test_a_slow_seat_is_reported():
    """A prediction takes the seat as linear between samples: docs/signals.md has its error by rate."""
    streams = independent_streams(6.0)
    assert not any("is slow" in line for line in one([thinned(each, 2) for each in streams]).warnings)
    (line,) = [line for line in one([thinned(each, 4) for each in streams]).warnings if "is slow" in line]
    assert line.startswith("seat: 282 Hz is slow: predicted doses and forces of fast motion are too low")


def test_the_mask_of_a_slow_sensor_covers_the_reach_of_its_own_filter():
    streams = [thinned(stream, 4) for stream in independent_streams(6.0)]
    good = one(streams, keep_level=True).measured_mps2[:, HEAD]
    head = one(changed(streams, "head", clip_at(1000, 1)), keep_level=True).measured_mps2[:, HEAD]
    assert 0 < np.isnan(head).sum() < 80
    wrong = 16.0 * STANDARD_GRAVITY_MPS2
    np.testing.assert_allclose(head, np.where(np.isnan(head), head, good), atol=1e-3 * wrong)


def test_a_clipped_seat_masks_all_segments_until_the_model_has_settled():
    streams, row = independent_streams(6.0), 3000
    good = one(streams)
    recording = one(changed(streams, "seat", clip_at(row, 1)))
    at = int(np.searchsorted(recording.stamps_ns, streams[0].stamps_ns[row]))
    end = at + REACH + round(WARM_UP_S * RATE_HZ)
    hit = np.isnan(recording.measured_mps2[at - REACH : end]).all(axis=0)
    assert hit.all()
    assert np.isfinite(recording.measured_mps2[100 : at - REACH - 2]).all()
    assert np.isfinite(recording.measured_mps2[end + 2 : -100]).all()
    assert np.isfinite(recording.seat_mps2).all()
    assert np.abs(recording.seat_mps2 - good.seat_mps2)[end:].max() < 0.01  # its level alone
    assert any(line.startswith("seat: invalid samples, so all segments are masked") for line in recording.warnings)


@pytest.mark.parametrize(("lost", "is_masked"), [(1, False), (3, False), (4, True), (40, True)])
def test_short_gaps_are_interpolated_and_longer_ones_masked(lost, is_masked):
    streams, row = independent_streams(6.0), 4000
    good = one(streams, keep_level=True)
    recording = one(changed(streams, "head", without(slice(row, row + lost))), keep_level=True)
    head = recording.measured_mps2[:, HEAD]
    at = int(np.searchsorted(recording.stamps_ns, streams[0].stamps_ns[row]))
    assert np.isnan(head[at : at + lost]).all() == is_masked
    # A bridge of 3.5 ms over 9.3 Hz errs by (pi f gap)^2 / 2 = 0.5 % of it, its low-passed trace by less.
    largest = np.nanmax(np.abs(good.measured_mps2[:, HEAD]))
    assert np.nanmax(np.abs(head - good.measured_mps2[:, HEAD])) < 0.005 * largest
    assert any(line.startswith(f"head: {counted(lost, 'sample')} interpolated") for line in recording.warnings)


def test_a_reading_of_nan_counts_as_lost():
    streams = independent_streams(6.0)
    rows = slice(4000, 4020)

    def spoil(stamps, samples):
        samples[rows] = np.nan
        return stamps, samples

    spoilt, lost = one(changed(streams, "head", spoil)), one(changed(streams, "head", without(rows)))
    np.testing.assert_array_equal(spoilt.measured_mps2, lost.measured_mps2)
    assert masked_s(lost, "head") > 20 / RATE_HZ


def test_a_stuck_sensor_is_masked():
    def stick(stamps, samples):
        samples[3000:] = samples[3000]
        return stamps, samples

    recording = one(changed(independent_streams(6.0), "head", stick))
    at = int(np.searchsorted(recording.stamps_ns, independent_streams(6.0)[0].stamps_ns[3000]))
    assert np.isnan(recording.measured_mps2[at:, HEAD]).all()
    assert np.isfinite(recording.measured_mps2[100 : at - REACH - 2, HEAD]).all()


def test_a_gap_of_the_seat_splits_the_record():
    streams = changed(noisy_streams(9.0), "seat", without(slice(6000, 6200)))
    first, second = recorded(streams)
    assert first.name == "drive (1 of 2)"
    assert second.name == "drive (2 of 2)"
    gap_s = 1e-9 * (second.stamps_ns[0] - first.stamps_ns[-1])
    assert gap_s == pytest.approx((201 + 2 * REACH) / RATE_HZ, abs=0.003)  # its ends are cut off
    assert any("split the record into 2" in line for line in first.warnings)
    # Each run fits the whole record's samples.
    whole = one(noisy_streams(9.0))
    for part in (first, second):
        at = int(np.searchsorted(whole.stamps_ns, part.stamps_ns[0]))
        expected = whole.measured_mps2[at : at + len(part.stamps_ns)]
        difference = part.measured_mps2 - expected
        assert np.nanstd(difference, axis=0).max() < 0.005  # the levels of parts differ, nothing else


def test_a_part_that_is_too_short_is_left_out_and_reported():
    streams = changed(noisy_streams(6.0), "seat", without(slice(6000, 6200)))
    recording = one(streams)
    assert any(line.startswith("a part is left out: ") and "too short" in line for line in recording.warnings)
    read = next(stream for stream in streams if stream.sensor == "seat").stamps_ns.size
    # Both parts lie behind the rest of 1 s; the recording itself lacks its two ends.
    assert recording.left_out_s == pytest.approx((read - 6000) / RATE_HZ, abs=0.01)
    assert one(noisy_streams(6.0)).left_out_s == 0.0


# --- levels ----------------------------------------------------------------------------------------------------------


def test_a_changed_level_is_subtracted_and_reported():
    def lean(stamps, samples):
        samples[1000:, 2] -= 0.5
        return stamps, samples

    streams = independent_streams(6.0)
    good, leant = one(streams), one(changed(streams, "head", lean))
    later = slice(round(WARM_UP_S * RATE_HZ), -50)
    # The step itself, 0.03 s behind the beginning of the recording, takes part in the mean, but for the taper.
    np.testing.assert_allclose(leant.measured_mps2[later], good.measured_mps2[later], atol=1e-4)
    assert any("head: its level has moved by -0.50" in line for line in leant.warnings)
    kept = one(changed(streams, "head", lean), keep_level=True)
    assert np.nanmean(kept.measured_mps2[later, HEAD] - good.measured_mps2[later, HEAD]) == pytest.approx(
        -0.5, abs=0.01
    )


@given(
    level=st.floats(-5.0, 5.0),
    frequency_hz=st.floats(1.4, 20.0),
    phase=st.floats(0.0, 6.28),
    seconds=st.floats(3.0, 8.0),
)
def test_vibration_is_no_level(level, frequency_hz, phase, seconds):
    time = np.arange(round(seconds * 500.0)) / 500.0
    values = level + np.sin(2.0 * np.pi * frequency_hz * time + phase)
    # The taper's spectrum at f T cycles: at most 1 / (pi f T ((f T)^2 - 1)), a plain mean's is 1 / (pi f T).
    cycles = frequency_hz * seconds
    assert level_mps2(values, 500.0) == pytest.approx(level, abs=1.1 / (np.pi * cycles * (cycles**2 - 1.0)))


def test_a_level_comes_from_the_longest_stretch_or_not_at_all():
    values = np.concatenate([np.full(1500, 7.0), [np.nan], np.full(1400, 3.0)])
    assert level_mps2(values, 500.0) == pytest.approx(7.0)
    assert level_mps2(values[600:], 500.0) == pytest.approx(3.0)
    assert level_mps2(values[:900], 500.0) is None
    assert level_mps2(np.full(10, np.nan), 500.0) is None


# --- refusals --------------------------------------------------------------------------------------------------------


def test_a_missing_segment_is_nan_and_reported():
    recording = one([stream for stream in independent_streams(6.0) if stream.sensor != "neck"])
    assert np.isnan(recording.measured_mps2[:, MEASURED_SEGMENTS.index("neck")]).all()
    assert np.isfinite(recording.measured_mps2[100:-100, HEAD]).all()
    assert "neck: not in the record" in recording.warnings


@pytest.mark.parametrize(
    ("streams", "wanted"),
    [
        (lambda: independent_streams(6.0)[1:], "drive: seat: not in the record"),
        (lambda: independent_streams(6.0)[:1], "nor is any other segment: nothing to compare"),
        (lambda: independent_streams(3.0), "2.14 s between rest, gaps and ends are too short: 3 s are needed"),
        (
            lambda: [quiet(stream) for stream in independent_streams(6.0)],
            "without excitation nothing can be identified",
        ),
        (lambda: [slow(stream) for stream in independent_streams(6.0)], "a rate of 112.9 Hz does not fit"),
        (
            lambda: [first(stream, 500) for stream in independent_streams(6.0)],
            "seat: gravity needs 0.8 s of samples (rest_s), 0.44 s have arrived",
        ),
        (
            lambda: [unreadable(stream) for stream in independent_streams(6.0)],
            "seat: gravity needs 0.8 s of readings (rest_s): none of the last 6 s can be used",
        ),
    ],
)
def test_an_unusable_record_is_refused_in_one_line(streams, wanted):
    with pytest.raises(InputError) as refusal:
        recorded(streams())
    assert wanted in str(refusal.value)
    assert str(refusal.value).startswith("drive: ")
    assert "\n" not in str(refusal.value)


def quiet(stream: ImuStream) -> ImuStream:
    noise = 0.01 * np.random.default_rng(1).standard_normal(stream.accel_mps2.shape)
    noise[:, 2] += STANDARD_GRAVITY_MPS2
    return dataclasses.replace(stream, accel_mps2=noise)


def unreadable(stream: ImuStream) -> ImuStream:
    return dataclasses.replace(stream, accel_mps2=np.full_like(stream.accel_mps2, np.nan))


def slow(stream: ImuStream) -> ImuStream:
    return dataclasses.replace(stream, stamps_ns=stream.stamps_ns[::10], accel_mps2=stream.accel_mps2[::10])


def first(stream: ImuStream, count: int) -> ImuStream:
    return dataclasses.replace(stream, stamps_ns=stream.stamps_ns[:count], accel_mps2=stream.accel_mps2[:count])


def test_a_spike_is_no_excitation():
    streams = changed([quiet(stream) for stream in independent_streams(6.0)], "seat", clip_at(5000, 1))
    with pytest.raises(InputError, match="without excitation"):
        recorded(streams)


def test_a_spike_is_no_seat_peak_of_the_fit():
    streams = independent_streams(6.0)
    plain, spiked = (one(each) for each in (streams, changed(streams, "seat", clip_at(5000, 1))))
    assert spiked.seat_invalid_s > 0.0 == plain.seat_invalid_s
    peak_mps2 = Case.of(plain).seat_peak_mps2
    assert peak_mps2 == pytest.approx(np.abs(plain.seat_mps2).max(), rel=0.01)
    assert np.abs(spiked.seat_mps2).max() > 2.0 * peak_mps2 and Case.of(spiked).seat_peak_mps2 <= peak_mps2


def test_an_unknown_sensor_is_refused():
    with pytest.raises(InputError, match="sensor 'knee' is unknown"):
        Recorder("road", "drive").push("knee", np.zeros(1, dtype=np.int64), np.zeros((1, 3)))


def test_a_given_vertical_is_used():
    def turned(stream: ImuStream) -> ImuStream:
        return dataclasses.replace(stream, accel_mps2=np.ascontiguousarray(stream.accel_mps2[:, [2, 0, 1]]))

    streams = independent_streams(6.0)
    recorder = Recorder("road", "drive", verticals=dict.fromkeys(SENSORS, (1.0, 0.0, 0.0)))
    for stream in map(turned, streams):
        recorder.push(stream.sensor, stream.stamps_ns, stream.accel_mps2)
    (found,) = recorder.finish()
    np.testing.assert_allclose(found.measured_mps2, one(streams).measured_mps2, atol=1e-9)


# --- representative trial --------------------------------------------------------------------------------------------


def trial(head_rms: float, early: float = 0.0) -> Recording:
    """A recording whose head moves so much behind the warm-up, and so much within it."""
    measured = np.zeros((4000, 5))
    measured[:, HEAD] = np.where(np.arange(4000) < 2000, early, head_rms)
    return Recording(f"{head_rms}", "road", 1000.0, np.arange(4000), np.ones(4000), measured, ())


def test_the_representative_trial_has_the_largest_head_rms_behind_the_warm_up():
    without_head = dataclasses.replace(trial(9.0), measured_mps2=np.full((4000, 5), np.nan))
    assert representative([trial(1.0, early=50.0), trial(3.0), without_head, trial(2.0)]).name == "3.0"
    with pytest.raises(InputError, match="no recording has a head"):
        representative([without_head])


# --- flags -----------------------------------------------------------------------------------------------------------


@given(st.lists(st.booleans(), max_size=40), st.integers(0, 5), st.integers(0, 5), st.integers(1, 4))
def test_widened_flags_equal_those_of_a_loop(flags, before, after, least):
    runs = []
    for i, flag in enumerate(flags):
        if flag and (i == 0 or not flags[i - 1]):
            runs.append([i, i])
        if flag:
            runs[-1][1] = i + 1
    assert stretches(np.array(flags, dtype=bool)) == [tuple(run) for run in runs]
    wide = [any(a - before <= i < b + after for a, b in runs if b - a >= least) for i in range(len(flags))]
    assert around(np.array(flags, dtype=bool), before, after, least).tolist() == wide


# --- bags ------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def rail_bag(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("bags") / "rail_crossing_2.mcap"
    simulate_bag(path, subject(), load_case("rail", 4.0, np.random.default_rng(3)), 3, SensorSettings())
    return path


def test_a_bag_becomes_a_recording(rail_bag):
    heard = []
    (recording,) = read_recordings(rail_bag, progress=lambda done, total: heard.append((done, total)))
    assert recording.case == "rail"
    assert recording.name == str(rail_bag)
    assert recording.warnings[0] == MADE_BY_MODEL
    assert heard[-1][0] == heard[-1][1] > 6 * 5 * RATE_HZ
    predicted = (
        Chain.of(subject()).simulate(recording.seat_mps2, recording.rate_hz).accel_mps2[:, MEASURED_SEGMENT_INDEX]
    )
    behind = round(WARM_UP_S * recording.rate_hz)
    error, measured = (predicted - recording.measured_mps2)[behind:], recording.measured_mps2[behind:]
    assert (np.nanmean(error**2, axis=0) < 0.15**2 * np.nanmean(measured**2, axis=0)).all()  # 0.2 ms of clock offset


def test_options_reach_the_conditioning(rail_bag):
    options = RecordingOptions(
        mapping={"neck": "imu/head/data", "head": "imu/neck/data"},
        conditioning=ConditioningSettings(cutoff_hz=40.0),
        recording=RecordingSettings(shortest_s=4.0),
    )
    (swapped,), (plain,) = read_recordings(rail_bag, "crossing", options), read_recordings(rail_bag)
    assert swapped.case == "crossing"
    assert swapped.stamps_ns[0] > plain.stamps_ns[0]  # a lower low-pass reaches further
    late = slice(3000, 4000)
    assert np.nanstd(swapped.measured_mps2[late, HEAD]) == pytest.approx(
        np.nanstd(plain.measured_mps2[late, MEASURED_SEGMENTS.index("neck")]), rel=0.3
    )
    with pytest.raises(InputError, match="too short: 60 s are needed"):
        read_recordings(rail_bag, options=RecordingOptions(recording=RecordingSettings(shortest_s=60.0)))
    with pytest.raises(InputError, match="vertical 'seat=up'"):
        read_recordings(rail_bag, options=RecordingOptions(vertical="seat=up"))


@pytest.mark.parametrize(
    ("bag", "case"),
    [
        ("logs/road.mcap", "road"),
        ("rail_crossing_2.mcap", "rail"),
        ("2026-01-01 Pothole 3.db3", "pothole"),
        ("gravel_03", "gravel"),
        ("gravel.mcap", "gravel"),
        ("trail_7.mcap", "trail"),
        ("road_rail_1.mcap", "road_rail"),
        ("007.mcap", "007"),
    ],
)
def test_the_file_names_the_case(bag, case):
    assert case_of(bag) == case


def test_start_is_the_first_stamp_of_the_streams():
    recording = one(independent_streams(6.0))
    rest_s = ConditioningSettings().rest_s
    assert 1e-9 * (recording.stamps_ns[0] - START_NS) == pytest.approx(rest_s + REACH / RATE_HZ, abs=0.005)
