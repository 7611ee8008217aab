"""Events of sessions: planted shocks are found in another simulation's drives, and rules hold on made seats."""

from __future__ import annotations

import dataclasses
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from pages import Page, empty_drawings
from recordings import tram
from scipy import signal
from world import sensors
from world.seats import RATE_HZ
from world.session import LEAST_G, SessionMotion, session

from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import SENSORS, STANDARD_GRAVITY_MPS2
from biodyn_core.conditioning.gravity import Gravity
from biodyn_core.sessions.bins import PIECE, Bins, Recut
from biodyn_core.sessions.cases import CaseSpan, with_cases
from biodyn_core.sessions.findings import Findings
from biodyn_core.sessions.relative_drift import PhaseMeter, block_extent
from biodyn_core.sessions.session import Session
from biodyn_core.sessions.settings import SessionSettings
from biodyn_ros.bag import BagWriter
from biodyn_ros.bag.cdr import IMU_TYPE, encode_imu
from biodyn_ros.base.topics import INPUT
from biodyn_ros.events.drawings import decimated
from biodyn_ros.events.finding import SessionOptions, find_events, find_sessions
from biodyn_ros.events.page import events_page
from biodyn_ros.events.text import text_of
from biodyn_ros.reading.events_file import load_events, write_events
from biodyn_ros.reading.parts import BagPart
from biodyn_ros.reading.sensors import ReadingOptions, open_sensors
from blind.sessions.finding import score_of

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

SEAT_HZ = 1129.3
START_NS = 1_700_000_000 * 10**9
G = STANDARD_GRAVITY_MPS2
UP = Gravity((0.0, 0.0, G), "session")
LEVEL = dict.fromkeys(SENSORS, UP)
PEAK_S = 0.1
"""Error of the time of a shock that is allowed."""


def drive(minutes: float, seed: int) -> tuple[SessionMotion, Integers, Floats]:
    """A drive of the other simulation, and its seat's stream."""
    rng = np.random.default_rng(seed)
    motion = session(minutes, rng)
    stamps, samples = sensors.drawn(rng).stream(motion.accel_mps2, RATE_HZ, rng)
    return motion, stamps, samples


def found_in(
    streams: dict[str, tuple[Integers, Floats]],
    settings: SessionSettings | None = None,
    gravity: dict[str, Gravity] | None = LEVEL,
) -> Findings:
    """The findings of streams; gravity: None to search for it at the start."""
    of = Session(int(streams["seat"][0][0]), settings=settings, gravity=gravity)
    for begin in range(0, max(len(stamps) for stamps, _ in streams.values()), 5000):
        for name, (stamps, samples) in streams.items():  # in turns, as in a bag
            of.push(name, stamps[begin : begin + 5000], samples[begin : begin + 5000])
    return of.finish()


def made(seconds: float, up_mps2: Floats | None = None, seed: int = 0) -> tuple[Integers, Floats]:
    """A stream of a level sensor: motion (n,) upwards on top of gravity, or rest."""
    count = round(seconds * SEAT_HZ)
    rng = np.random.default_rng(seed)
    samples = np.zeros((count, 3)) + [0.0, 0.0, G] + 0.02 * rng.standard_normal((count, 3))
    if up_mps2 is not None:
        samples[:, 2] += up_mps2
    return START_NS + np.rint(np.arange(count) * 1e9 / SEAT_HZ).astype(np.int64), samples


def shaken(seconds: float, rms_mps2: float, begin_s: float = 5.0, seed: int = 1) -> Floats:
    """A rest of begin_s, then white noise between 1 and 20 Hz."""
    count = round(seconds * SEAT_HZ)
    rng = np.random.default_rng(seed)
    frequency = np.fft.rfftfreq(count, 1.0 / SEAT_HZ)
    spectrum = rng.standard_normal(frequency.size) + 1j * rng.standard_normal(frequency.size)
    noise = np.fft.irfft(np.where((frequency > 1.0) & (frequency < 20.0), spectrum, 0.0), count)
    noise *= rms_mps2 / noise.std()
    noise[: round(begin_s * SEAT_HZ)] = 0.0
    return noise


def with_shocks(up_mps2: Floats, at_s: list[float], peak_g: float = 1.5) -> Floats:
    """Half-sines of 60 ms added."""
    moved = up_mps2.copy()
    length = round(0.06 * SEAT_HZ)
    for each in at_s:
        begin = round((each - 0.03) * SEAT_HZ)
        moved[begin : begin + length] += peak_g * G * np.sin(np.pi * np.arange(length) / length)
    return moved


def bag_of(path: Path, stamps_ns: Integers, samples: Floats) -> Path:
    """A bag of a seat."""
    with BagWriter(path) as writer:
        writer.add_topic(INPUT["seat"], IMU_TYPE)
        writer.write(INPUT["seat"], stamps_ns, encode_imu(stamps_ns, samples, None, "seat"))
    return path


def test_planted_shocks_are_found_and_named() -> None:
    """By the study's own counts; 40 minutes are in docs/sessions_study.md."""
    score = score_of(6.0, 21)
    assert score.planted >= 15 and score.found >= 0.95 * score.planted and score.invented == 0
    assert score.right >= 0.9 * score.events
    assert score.rests_found == score.rests >= 2


def test_a_shock_below_the_least_peak_is_no_event() -> None:
    motion, stamps, samples = drive(3.0, 23)
    weak = [one.peak_s for one in motion.planted if 0.0 < one.peak_g < LEAST_G - 0.05]
    found = found_in({"seat": (stamps, samples)})
    assert weak
    assert not [
        event for event in found.events for shock in event.shocks if min(abs(shock.time_s - at) for at in weak) < 0.1
    ]


@cache
def uncut() -> tuple[Integers, Floats, Findings]:
    """A stream of a seat, and its findings."""
    stamps, samples = made(26.0, with_shocks(shaken(26.0, 0.8), [14.0, 20.0]))
    return stamps, samples, found_in({"seat": (stamps, samples)})


@settings(max_examples=20)
@given(st.lists(st.integers(1, 29_000), min_size=1, max_size=6))
def test_cuts_change_no_number(cuts: list[int]) -> None:
    stamps, samples, whole = uncut()
    assert sum(len(event.shocks) for event in whole.events) == 2 and whole.rests
    of = Session(int(stamps[0]), gravity=LEVEL)
    edges = sorted({0, *(cut for cut in cuts if cut < len(stamps)), len(stamps)})
    for begin, end in pairwise(edges):
        of.push("seat", stamps[begin:end], samples[begin:end])
    parts = of.finish()
    assert parts.events == whole.events and parts.rests == whole.rests
    assert np.array_equal(parts.timeline.peak_mps2, whole.timeline.peak_mps2)


def test_an_event_has_its_warm_up_and_a_near_shock_joins_it() -> None:
    up = with_shocks(shaken(60.0, 0.5), [15.0, 20.0, 21.8, 40.0])
    found = found_in({"seat": made(60.0, up)})
    shocks = [[round(shock.time_s, 1) for shock in event.shocks] for event in found.events if event.shocks]
    assert shocks == [[15.0], [20.0, 21.8], [40.0]]
    for event in found.events:
        if event.shocks:
            assert event.shocks[0].time_s - event.begin_s >= 2.0
    edges = [(event.begin_s, event.end_s) for event in found.events]
    assert all(one[1] <= other[0] for one, other in pairwise(edges))
    assert {event.case for event in found.events if not event.shocks} == {"road"}


def test_a_shock_without_a_warm_up_is_left_out_with_its_reason() -> None:
    found = found_in({"seat": made(30.0, with_shocks(shaken(30.0, 0.5, begin_s=0.5), [1.5]))})
    assert not [event for event in found.events if event.shocks]
    assert any("warm-up" in line for line in found.warnings)


def test_the_reason_reaches_the_user_of_a_bag(tmp_path: Path) -> None:
    up = with_shocks(shaken(30.0, 0.5, begin_s=0.5), [1.5])
    warnings = find_events(bag_of(tmp_path / "a.mcap", *made(30.0, up))).all_warnings
    assert any(line.startswith("a shock at 1.5 s is left out: ") for line in warnings)
    assert [line for line in warnings if line.startswith("head: ")] == ["head: not in the bag"]


def test_a_session_at_rest_gives_gravity_to_another(tmp_path: Path) -> None:
    """The remedy that is offered for a session without rest: another one with some seconds at rest."""
    stamps, samples = made(30.0, shaken(30.0, 0.8, begin_s=0.0))
    moving = bag_of(tmp_path / "moving.mcap", stamps + 100 * 10**9, samples)
    rest = bag_of(tmp_path / "rest.mcap", *made(20.0))
    options = SessionOptions(allowed=("one-condition",))
    with pytest.raises(InputError, match=r"moving.mcap: no rest in 30.0 s"):
        find_sessions([moving], options, lambda done, total: None)
    sessions = find_sessions([moving, rest], options, lambda done, total: None)
    write_events(sessions, tmp_path / "both.yaml")
    assert {part.rest_bag for part in load_events(tmp_path / "both.yaml")} == {rest}
    assert "1 rest of 20.0 s in all, 0 events\n" in text_of(sessions)
    with pytest.raises(InputError, match=r"rest.mcap: no event in 20.0 s"):
        find_sessions([rest], options, lambda done, total: None)
    with empty_drawings():
        assert "rest.mcap" in Page(events_page(sessions)).text


@pytest.mark.parametrize(("hours", "begin_s"), [(1.6, 5755.0), (24.0, 86390.0)])
def test_the_last_event_of_a_long_session_is_read(hours: float, begin_s: float, tmp_path: Path) -> None:
    """The clock of the seat is 200 ppm fast: its last stamps are later than the end of the bag by the recorder's."""
    since_ns = 10**9 * np.arange(round(3600 * hours) + 1)
    logged_ns = START_NS + np.rint((1.0 - 2e-4) * since_ns).astype(np.int64)
    with BagWriter(tmp_path / "a.mcap") as writer:
        writer.add_topic(INPUT["seat"], IMU_TYPE)
        samples = np.tile([0.0, 0.0, G], (since_ns.size, 1))
        writer.write(INPUT["seat"], logged_ns, encode_imu(START_NS + since_ns, samples, None, "seat"))
    end_s = 1e-9 * float(since_ns[-1])
    with open_sensors(BagPart(tmp_path / "a.mcap", begin_s, end_s), ReadingOptions()) as reading:
        stamps = np.concatenate([block.stamps_ns for _, block in reading.blocks(lambda done, total: None)])
    assert np.array_equal(stamps, START_NS + since_ns[round(begin_s) :])
    outside = f"{tmp_path / 'a.mcap'}@9..86430"
    with pytest.raises(InputError, match="outside the bag"), open_sensors(outside, ReadingOptions()):
        pass


def test_only_the_shocks_in_the_warm_up_are_left_out() -> None:
    """They are the largest; the later shocks of their group are an event, and the rest is steady."""
    up = with_shocks(shaken(30.0, 0.5, begin_s=0.5), [2.6, 3.5, 4.4], peak_g=1.3)
    found = found_in({"seat": made(30.0, with_shocks(up, [0.9, 1.7], peak_g=1.8))})
    first, *others = found.events
    assert (first.case, first.shocks[0].time_s) == ("rail", first.peak_s)
    assert first.begin_s == 0.0 and first.end_s == pytest.approx(6.4, abs=PEAK_S)
    assert min(abs(first.peak_s - at_s) for at_s in (2.6, 3.5, 4.4)) < PEAK_S
    assert [(one.case, one.begin_s, one.end_s) for one in others] == [("road", first.end_s, pytest.approx(30.0))]
    assert [line.partition(":")[0] for line in found.warnings if "warm-up" in line] == [
        "2 shocks from 0.9 to 1.7 s are left out"
    ]


def test_a_shock_just_after_a_gap_is_in_no_steady_event() -> None:
    """Its strike before the gap is of an event that the gap ends."""
    stamps, samples = made(40.0, with_shocks(shaken(40.0, 0.5), [14.9, 15.4, 16.9]))
    time_s = np.arange(len(stamps)) / SEAT_HZ
    there = (time_s < 15.0) | (time_s > 15.2)
    found = found_in({"seat": (stamps[there], samples[there])})
    steady = [event for event in found.events if not event.shocks]
    assert steady[-1].begin_s == pytest.approx(18.9, abs=PEAK_S)
    assert all(event.peak_mps2 < 0.8 * G for event in steady)
    (shocks,) = [event.shocks for event in found.events if event.shocks]
    assert [shock.time_s for shock in shocks] == [pytest.approx(14.9, abs=PEAK_S)]
    assert any(line.startswith("2 shocks from 15.4 to 16.9 s are left out: ") for line in found.warnings)


def test_strikes_that_follow_each_other_are_a_train() -> None:
    up = with_shocks(shaken(40.0, 0.4), [20.0, 20.3, 20.6, 20.9])
    (event,) = [event for event in found_in({"seat": made(40.0, up)}).events if event.shocks]
    assert event.case == "rail"
    renamed = found_in({"seat": made(40.0, up)}, SessionSettings(train_case="joint"))
    assert "joint_01" in [event.name for event in renamed.events]


def test_the_facts_of_an_event_are_those_of_its_samples() -> None:
    """A sine of 8 Hz has a weighted rms of Wk's gain there, 1.036 (ISO 2631-1, Table 3), times its rms."""
    count = round(40.0 * SEAT_HZ)
    sine = np.sqrt(2.0) * np.sin(2.0 * np.pi * 8.0 * np.arange(count) / SEAT_HZ)
    sine[: round(5.0 * SEAT_HZ)] = 0.0
    found = found_in({"seat": made(40.0, sine)})
    (event,) = found.events[-1:]
    assert event.level_mps2 == pytest.approx(1.0, rel=0.01) and event.peak_mps2 == pytest.approx(np.sqrt(2.0), rel=0.06)
    assert event.aw_mps2 == pytest.approx(1.036, rel=0.01)


def test_an_engine_that_idles_is_no_drive() -> None:
    count = round(60.0 * SEAT_HZ)
    shake = 0.6 * np.sin(2.0 * np.pi * 28.0 * np.arange(count) / SEAT_HZ)
    found = found_in({"seat": made(60.0, shake)}, SessionSettings(rest_level_mps2=0.1))
    assert found.events == ()
    driven = found_in({"seat": made(60.0, shake)}, SessionSettings(rest_level_mps2=0.1, idle_level_mps2=0.1))
    assert driven.events


def test_a_rest_gives_the_gravity_of_the_sensors_that_rest() -> None:
    """The head moves in the first rest, and is mounted otherwise in the last."""
    up = shaken(60.0, 0.8)
    up[round(50.0 * SEAT_HZ) :] = 0.0
    stamps, head = made(60.0, up, seed=2)
    nodding = round(4.0 * SEAT_HZ)
    head[:nodding, 0] += 2.0 * np.sin(2.0 * np.pi * np.arange(nodding) / SEAT_HZ)
    neck = made(60.0, up, seed=3)[1]
    after = round(50.0 * SEAT_HZ)
    turn = np.deg2rad(12.0)
    neck[after:] = neck[after:] @ np.array(
        [[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]]
    )
    found = found_in({"seat": made(60.0, up), "head": (stamps, head), "neck": (stamps, neck)})
    first, last = found.rests
    assert "head" not in first.gravity_mps2 and set(last.gravity_mps2) == {"seat", "head", "neck"}
    assert first.gravity_mps2["seat"] == pytest.approx((0.0, 0.0, G), abs=0.01)
    assert last.gravity_mps2["neck"] == pytest.approx((-G * np.sin(turn), 0.0, G * np.cos(turn)), abs=0.02)
    assert any(line.startswith("neck: turned by 12 deg") for line in found.warnings)
    assert [event.rest for event in found.events] == [0, 1]


def test_peaks_of_a_rough_road_are_no_shocks() -> None:
    """At 2 m/s^2 rms peaks of 0.8 g are 4 times the level, and not rare."""
    up = shaken(120.0, 2.0)
    assert np.abs(up).max() > LEAST_G * G
    found = found_in({"seat": made(120.0, up)})
    assert found.events and not [event for event in found.events if event.shocks]
    by_peak = found_in({"seat": made(120.0, up)}, SessionSettings(shock_crest=3.0))
    assert any(event.shocks for event in by_peak.events)


@pytest.mark.parametrize("reading", [(0.0, 0.0, 2.0), (30.0, 40.0, 120.0)])
def test_a_seat_that_repeats_one_reading_is_not_at_rest(reading: tuple[float, ...]) -> None:
    """Two stops with an engine that idles, and between them the same reading in motion for 8 s, as after a fault."""
    idling = 0.3 * np.sin(2.0 * np.pi * 25.0 * np.arange(round(90.0 * SEAT_HZ)) / SEAT_HZ)
    motion = shaken(90.0, 1.0, begin_s=12.0)
    motion[round(70.0 * SEAT_HZ) : round(82.0 * SEAT_HZ)] = 0.0
    stamps, samples = made(90.0, motion + idling)
    stops = [(rest.begin_s, rest.end_s) for rest in found_in({"seat": (stamps, samples)}).rests]
    assert len(stops) == 2 and sum(end - begin for begin, end in stops) > 20.0
    begin = round(40.0 * SEAT_HZ)
    samples[begin : begin + round(8.0 * SEAT_HZ)] = samples[begin] + reading
    found = found_in({"seat": (stamps, samples)})
    assert [(rest.begin_s, rest.end_s) for rest in found.rests] == stops
    assert [(fault.kind, fault.begin_s) for fault in found.faults] == [("stuck", 40.0)]
    assert not [line for line in found.warnings if "repeats one reading" in line]


def test_a_coarse_seat_is_at_rest_where_it_repeats_one_reading() -> None:
    stamps, samples = made(60.0, shaken(60.0, 1.0, begin_s=12.0))
    coarse = np.round(samples / 0.25) * 0.25
    found = found_in({"seat": (stamps, coarse)})
    (rest,) = found.rests
    assert rest.begin_s == 0.0 and rest.end_s == pytest.approx(12.0, abs=0.5)
    assert [line for line in found.warnings if line.startswith("seat: repeats one reading in the rest from 0 to 12 s")]


def test_a_coarse_seat_that_returns_to_its_reading_is_at_rest_and_not_where_it_gathers_speed() -> None:
    """Steps of 0.16 m/s^2: without noise at the three stops, with noise where the speed changes smoothly."""
    stamps, samples = made(170.0, shaken(170.0, 1.2))
    smooth = np.random.default_rng(3).standard_normal(len(samples))
    for begin_s, end_s, ahead in ((0, 20, 0.0), (20, 30, 1.2), (70, 80, -1.2), (80, 95, 0.0), (95, 105, 1.2),
                                  (145, 155, -1.2), (155, 170, 0.0)):  # fmt: skip
        here = slice(round(begin_s * SEAT_HZ), round(end_s * SEAT_HZ))
        samples[here] = [0.06 + ahead, -0.04, G]
        samples[here] += 0.2 * smooth[here, None] * [0.0, 0.0, abs(ahead)] + 0.004 * smooth[here, None]
    found = found_in({"seat": (stamps, np.round(samples / 0.16) * 0.16)})
    assert [rest.begin_s for rest in found.rests] == pytest.approx([1.0, 80.0, 155.0], abs=1.0)
    assert all(rest.gravity_mps2["seat"][0] == pytest.approx(0.0, abs=0.1) for rest in found.rests)


@pytest.mark.parametrize("share", [0.4, 0.7])
def test_a_rest_leaves_out_the_part_in_which_a_sensor_is_stuck(share: float) -> None:
    stamps, samples = made(60.0, shaken(60.0, 1.0, begin_s=20.0))
    stuck = samples.copy()
    stuck[: round(20.0 * share * SEAT_HZ)] = [0.0, 1.6, 9.6]
    found = found_in({"seat": (stamps, samples), "head": (stamps, stuck)})
    (rest,) = found.rests
    assert rest.gravity_mps2["head"] == pytest.approx((0.0, 0.0, G), abs=0.01)
    assert "head: repeats one reading in a part of the rest from 0 to 20 s: its gravity leaves this part out" in (
        found.warnings
    )


@pytest.mark.parametrize("frozen_s", [[(40.0, 75.0)], [(50.0, 62.0), (65.0, 77.0)]])
def test_a_seat_that_is_frozen_while_the_others_move_is_not_at_rest(frozen_s: list[tuple[float, float]]) -> None:
    """It freezes during a stop, and the vehicle drives on; or it repeats the reading of a stop in a loss, twice."""
    moving = shaken(100.0, 1.0, begin_s=12.0)
    moving[round(35.0 * SEAT_HZ) : round(45.0 * SEAT_HZ)] = 0.0
    streams = {name: made(100.0, moving, seed) for seed, name in enumerate(("seat", "pelvis", "head"))}
    stops = found_in(streams).rests
    assert [rest.begin_s for rest in stops] == pytest.approx([1.0, 35.0], abs=1.0)
    samples = streams["seat"][1]
    for begin_s, end_s in frozen_s:
        samples[round(begin_s * SEAT_HZ) : round(end_s * SEAT_HZ)] = [0.0, 0.0, G]
    found = found_in(streams)
    ends_s = [12.0, min(45.0, frozen_s[0][0])]
    assert [rest.end_s for rest in found.rests] == pytest.approx(ends_s, abs=6.6)
    assert all(rest.end_s < 47.0 for rest in found.rests)


@pytest.mark.parametrize("dead", [("pelvis", 30.0, 100.0), ("pelvis", 50.0, 62.0)])
def test_a_sensor_that_is_stuck_too_does_not_vouch_for_a_seat(dead: tuple[str, float, float]) -> None:
    moving = shaken(100.0, 0.8, begin_s=12.0)
    moving[round(88.0 * SEAT_HZ) :] = 0.0
    streams = {name: made(100.0, moving, seed) for seed, name in enumerate(("seat", "pelvis", "head"))}
    stops = [(rest.begin_s, rest.end_s) for rest in found_in(streams).rests]
    assert len(stops) == 2
    for name, begin_s, end_s in (dead, ("seat", 50.0, 62.0)):
        here = slice(round(begin_s * SEAT_HZ), round(end_s * SEAT_HZ))
        streams[name][1][here] = streams[name][1][here.start] + [1.2, 0.0, 0.0]
    assert [(rest.begin_s, rest.end_s) for rest in found_in(streams).rests] == stops


def test_a_session_of_a_few_seconds_has_its_rest() -> None:
    found = found_in({"seat": made(4.0), "head": made(4.0, seed=1)})
    assert [(rest.begin_s, rest.end_s) for rest in found.rests] == [(0.0, 4.0)]


def test_a_coarse_seat_is_at_rest_beside_a_person_who_nods() -> None:
    moving = shaken(100.0, 1.0, begin_s=12.0)
    moving[round(88.0 * SEAT_HZ) :] = 0.0
    stamps, samples = made(100.0, moving)
    time = np.arange(len(samples)) / SEAT_HZ
    nod = np.where(time % 2.0 < 0.6, 0.6 * np.sin(2.0 * np.pi * 2.0 * time), 0.0)
    found = found_in({"seat": (stamps, np.round(samples / 0.25) * 0.25), "head": made(100.0, moving + nod, 1)})
    assert [rest.begin_s for rest in found.rests] == pytest.approx([0.0, 88.0], abs=1.0)
    assert all(event.rest is not None for event in found.events)


def test_a_coarse_seat_is_at_rest_where_another_sensor_is_quiet() -> None:
    """At one stop alone: the seat does not return to its reading."""
    up = shaken(60.0, 1.0, begin_s=12.0)
    stamps, samples = made(60.0, up)
    samples[round(40.0 * SEAT_HZ) : round(50.0 * SEAT_HZ)] = [1.0, 0.0, G]  # gathers speed smoothly, with noise
    samples[round(40.0 * SEAT_HZ) : round(50.0 * SEAT_HZ)] += 0.2 * made(10.0)[1] - [0.0, 0.0, 0.2 * G]
    coarse = np.round(samples / 0.25) * 0.25
    coarse[round(40.0 * SEAT_HZ) : round(50.0 * SEAT_HZ)] += 0.02 * made(10.0)[1] - [0.0, 0.0, 0.02 * G]
    found = found_in({"seat": (stamps, coarse), "pelvis": made(60.0, up, seed=5)})
    assert found.rests[0].begin_s == pytest.approx(1.0, abs=1.0)
    assert found.rests[0].end_s == pytest.approx(12.0, abs=0.6)


def test_a_sensor_by_another_clock_is_named() -> None:
    seat, head = (made(60.0, shaken(60.0, 1.0, seed=seed)) for seed in (1, 2))
    found = found_in({"seat": seat, "head": (head[0] - 10**15, head[1])})
    assert "head: its stamps are before the seat's: another clock; use --time log" in found.warnings


def test_a_body_sensor_that_repeats_one_reading_in_a_rest_has_no_gravity_there() -> None:
    stamps, samples = made(60.0, shaken(60.0, 1.0, begin_s=20.0))
    stuck = samples.copy()
    stuck[: round(20.0 * SEAT_HZ)] = [0.0, 1.0, 9.0]
    found = found_in({"seat": (stamps, samples), "head": (stamps, stuck)})
    (rest,) = found.rests
    assert set(rest.gravity_mps2) == {"seat"}
    assert [line for line in found.warnings if line.startswith("head: repeats one reading in the rest from 0 to 20 s")]


def test_a_vehicle_that_gathers_speed_smoothly_is_not_at_rest() -> None:
    """Up to 1.4 m/s^2 forward for 10 s, as a tram: quieter than 0.3 m/s^2 rms, but louder than at a stop."""
    stamps, samples = made(60.0, shaken(60.0, 0.8))
    quiet = slice(round(30.0 * SEAT_HZ), round(40.0 * SEAT_HZ))
    count = quiet.stop - quiet.start
    samples[quiet] = [0.0, 0.0, G] + 0.12 * np.random.default_rng(0).standard_normal((count, 3))
    samples[quiet, 0] += 1.2 * np.interp(np.arange(count) / SEAT_HZ, [0.0, 4.0, 6.0, 10.0], [0.0, 1.2, 1.2, 0.0])
    rests = found_in({"seat": (stamps, samples)}).rests
    assert [(rest.begin_s, rest.end_s) for rest in rests] == [(0.0, 5.0)]


@pytest.mark.parametrize("forward_mps2", [0.3, 0.8, 1.3])
@pytest.mark.parametrize("jolt_s", [0.0, 1.0])
def test_a_vehicle_that_gathers_speed_as_quietly_as_it_stands_is_not_at_rest(
    forward_mps2: float, jolt_s: float
) -> None:
    """A stop of 5 s, 8 s of gathering speed, a drive, 10 s of braking, a stop of 12 s; with and without jolts."""
    up, jolts = shaken(62.0, 0.8, 13.0), shaken(62.0, 0.8, 0.0)
    up[round(40.0 * SEAT_HZ) :] = 0.0
    for at_s in (5.0, 50.0):
        jolt = slice(round(at_s * SEAT_HZ), round((at_s + jolt_s) * SEAT_HZ))
        up[jolt] = jolts[jolt]
    stamps, samples = made(62.0, up)
    time_s = np.arange(len(stamps)) / SEAT_HZ
    samples[(time_s >= 5.0) & (time_s < 13.0), 0] += forward_mps2
    samples[(time_s >= 40.0) & (time_s < 50.0), 0] -= forward_mps2
    found = found_in({"seat": (stamps, samples)})
    rests = [time for rest in found.rests for time in (rest.begin_s, rest.end_s)]
    assert rests == pytest.approx([0.0, 5.0, 50.0 + jolt_s, 62.0], abs=0.6)
    assert found.events and not [line for line in found.warnings if "turned" in line]


def test_a_rest_on_a_slope_gives_no_gravity_and_no_alarm() -> None:
    """The vehicle stands three times, once tilted by 8 deg; all sensors turn with it."""
    up = shaken(120.0, 0.8)
    for begin_s in (40.0, 80.0):
        up[round(begin_s * SEAT_HZ) : round((begin_s + 10.0) * SEAT_HZ)] = 0.0
    lean = np.deg2rad(8.0)
    turn = np.array([[np.cos(lean), 0, np.sin(lean)], [0, 1, 0], [-np.sin(lean), 0, np.cos(lean)]])
    streams = {}
    for number, name in enumerate(("seat", "head")):
        stamps, samples = made(120.0, up, seed=number)
        here = slice(round(40.0 * SEAT_HZ), round(50.0 * SEAT_HZ))
        samples[here] = samples[here] @ turn
        streams[name] = stamps, samples
    found = found_in(streams)
    assert len(found.rests) == 3 and {event.rest for event in found.events} == {0, 2}
    assert not [line for line in found.warnings if "turned" in line]


def test_the_rests_of_a_recorded_tram_are_its_stops(shared_data: Path) -> None:
    """By eye: 12 to 46, 99 to 112, 171 to 187, and 235 s to the end; a swaying passenger may divide one."""
    stamps, samples = tram(shared_data, "L3_StnVinohrady_Riazanska.csv")
    found = found_in({"seat": (stamps, samples)}, gravity=None)
    stops = [(12.0, 46.5), (99.0, 112.5), (171.0, 187.0), (235.0, 240.0)]
    for rest in found.rests:
        assert any(begin - 1.0 <= rest.begin_s and rest.end_s <= end + 1.0 for begin, end in stops)
    for begin, end in stops:
        rested = sum(max(0.0, min(rest.end_s, end) - max(rest.begin_s, begin)) for rest in found.rests)
        assert rested > 0.75 * (end - begin)
    assert {event.case for event in found.events} == {"road"}


def test_a_gap_of_the_seat_is_a_gap_in_the_timeline() -> None:
    stamps, samples = made(60.0, shaken(60.0, 0.8))
    there = (np.arange(stamps.size) < 20.0 * SEAT_HZ) | (np.arange(stamps.size) > 35.0 * SEAT_HZ)
    lines = found_in({"seat": (stamps[there], samples[there])}).timeline
    time_s, peak = decimated(lines.peak_mps2, lines.width_s, np.nanmax)
    gap = (time_s > 20.1) & (time_s < 34.9)
    assert np.isnan(peak[gap]).all() and (peak[(time_s > 6.0) & ~gap & (time_s < 19.9)] > 0.1).all()


def test_faults_of_sensors_are_stretches_and_in_the_quality_of_events() -> None:
    up = shaken(60.0, 0.8)
    stamps, samples = made(60.0, up)
    gone = (np.arange(len(stamps)) < round(20.0 * SEAT_HZ)) | (np.arange(len(stamps)) > round(21.0 * SEAT_HZ))
    clipped = made(60.0, up, seed=4)[1]
    clipped[round(30.0 * SEAT_HZ) : round(30.0 * SEAT_HZ) + 3, 2] = 160.0
    held = made(60.0, up, seed=5)[1]
    held[round(40.0 * SEAT_HZ) : round(43.0 * SEAT_HZ)] = [0.0, 0.0, G]
    found = found_in(
        {
            "seat": (stamps, samples),
            "head": (stamps[gone], samples[gone]),
            "neck": (stamps, clipped),
            "pelvis": (stamps, held),
        }
    )
    of = {(fault.sensor, fault.kind): (fault.begin_s, fault.end_s) for fault in found.faults}
    assert of["head", "missing"] == pytest.approx((20.0, 21.0), abs=0.6)
    assert of["neck", "clipped"] == pytest.approx((30.0, 30.5), abs=0.6)
    assert of["pelvis", "stuck"][0] == pytest.approx(40.5, abs=1.0)
    lines = [line for event in found.events for line in event.quality]
    assert {line.partition(":")[0] for line in lines} == {"head", "neck", "pelvis"}
    assert "neck: 3 samples clipped" in lines


def test_no_sample_is_missing_after_the_end_of_the_recording() -> None:
    """It ends within an interval of half a second; the head stops 0.3 s earlier, in the last event."""
    up = with_shocks(shaken(40.28, 0.5), [38.6])
    (stamps, samples), early = made(40.28, up), round(39.98 * SEAT_HZ)
    found = found_in({"seat": (stamps, samples), "neck": (stamps, samples), "head": (stamps[:early], samples[:early])})
    last = found.events[-1]
    assert last.end_s == pytest.approx(40.28)
    assert last.quality == (f"head: {100.0 * 0.3 / (40.28 - last.begin_s):.0f} % missing",)


def test_a_seat_gap_ends_an_event() -> None:
    up = shaken(60.0, 0.8)
    stamps, samples = made(60.0, up)
    there = (np.arange(len(stamps)) < round(30.0 * SEAT_HZ)) | (np.arange(len(stamps)) > round(32.0 * SEAT_HZ))
    found = found_in({"seat": (stamps[there], samples[there])})
    assert not [event for event in found.events if event.begin_s < 30.5 and event.end_s > 31.5]
    assert found.events[-1].begin_s == pytest.approx(32.0, abs=0.2)


def test_a_clock_that_is_set_back_is_refused() -> None:
    stamps, samples = made(40.0, shaken(40.0, 0.8))
    back = stamps.copy()
    back[round(20.0 * SEAT_HZ) :] -= 10 * 10**9
    with pytest.raises(InputError, match=r"seat: time is set back by 10\.0 s after 20\.0 s"):
        found_in({"seat": (back, samples)})


def body_of(up_mps2: Floats) -> Floats:
    """A mass on a spring, 5 Hz, in the place of a body: absolute acceleration (n,)."""
    omega = 2.0 * np.pi * 5.0
    return np.asarray(
        signal.lfilter(*signal.bilinear([0.6 * omega, omega**2], [1.0, 0.6 * omega, omega**2], SEAT_HZ), up_mps2)
    )


@pytest.mark.parametrize("ppm", [60.0, -15.0])
def test_the_drift_of_a_clock_is_found_with_its_error(ppm: float) -> None:
    """Rest, short drives, shocks and a gap of the sensor do not matter."""
    up = with_shocks(shaken(400.0, 0.8), [100.0, 200.0, 320.0])
    up[(np.arange(up.size) / SEAT_HZ) % 14.0 > 9.0] = 0.0
    seat, (stamps, samples) = made(400.0, up), made(400.0, body_of(up), seed=7)
    drifted = stamps + np.rint(1e-6 * ppm * (stamps - stamps[0])).astype(np.int64)
    there = (np.arange(stamps.size) < round(150.0 * SEAT_HZ)) | (np.arange(stamps.size) > round(170.0 * SEAT_HZ))
    found = found_in({"seat": seat, "head": (drifted[there], samples[there]), "neck": (stamps, samples)})
    (name,) = found.drifts
    assert name == "head"
    assert abs(found.drifts["head"].ppm - ppm) < 4.0 * found.drifts["head"].error_ppm < 4.0
    assert any(line.startswith("head: its clock drifts by ") for line in found.warnings)


@pytest.mark.parametrize(("of_seat", "is_known"), [(0.0, False), (0.25, True)])
def test_a_sensor_that_does_not_follow_the_seat_has_no_drift(of_seat: float, is_known: bool) -> None:
    """Ten minutes each: the best drift of an independent sensor is that of chance."""

    def noise(seed: int) -> Floats:
        rows = np.random.default_rng(seed).standard_normal(30_000)
        return np.asarray(signal.sosfilt(signal.butter(2, (1.0, 12.0), "bandpass", fs=50.0, output="sos"), rows))

    for seed in range(12):
        seat, meter = noise(2 * seed), PhaseMeter(0.02, 0.1)
        sensor = noise(2 * seed + 1) + of_seat * seat
        for number in range(len(seat)):
            begin, end = block_extent(number)
            if end > len(seat):
                break
            meter.add(number, seat[begin:end], sensor[begin:end], np.ones(end - begin, dtype=bool))
        found = meter.drift()
        assert (found is not None) == is_known
        assert found is None or abs(found.ppm) < 4.0 * found.error_ppm or found.apart_s(600.0) < 5e-4


def softening(up_mps2: Floats, rate_hz: float, soft_m: float = 2e-3) -> Floats:
    """A body of 4 Hz whose spring force bends over at a deflection of soft_m, by the semi-implicit Euler rule."""
    omega, step_s = 2.0 * np.pi * 4.0, 1.0 / rate_hz
    deflection, speed, out = 0.0, 0.0, []
    for seat in up_mps2.tolist():
        force = -(omega**2) * deflection / (1.0 + abs(deflection) / soft_m) - 0.8 * omega * speed
        speed += step_s * (force - seat)
        deflection += step_s * speed
        out.append(force)
    return np.array(out)


@pytest.mark.parametrize("ppm", [0.0, 100.0])
def test_a_body_that_softens_as_the_level_rises_is_no_drift(ppm: float) -> None:
    """From 0.2 to 2 m/s^2 in ten minutes; a drift of the clock that is large beside the change is corrected."""
    rate_hz = 500.0
    time_s = np.arange(round(600.0 * rate_hz)) / rate_hz
    white = np.random.default_rng(3).standard_normal(time_s.size)
    band = signal.sosfilt(signal.butter(2, (1.0, 20.0), "bandpass", fs=rate_hz, output="sos"), white)
    up = np.linspace(0.2, 2.0, time_s.size) * band / band.std()
    body = np.interp(time_s / (1.0 + 1e-6 * ppm), time_s, softening(up, rate_hz))
    seat, sensor = (rows.reshape(-1, 10).mean(axis=1) for rows in (up, body))
    meter, number = PhaseMeter(0.02, 0.1), 0
    while block_extent(number)[1] <= seat.size:
        here = slice(*block_extent(number))
        meter.add(number, seat[here], sensor[here], np.ones(here.stop - here.start, dtype=bool))
        number += 1
    found = meter.drift()
    assert found is not None and abs(found.ppm) > 4.0 * found.chance_ppm
    assert abs(found.ppm - ppm) < 4.0 * found.error_ppm
    assert (abs(found.ppm) > 4.0 * found.error_ppm) == (ppm > 0.0)


def test_without_motion_there_is_no_drift() -> None:
    stamps, samples = made(100.0)
    drifted = stamps + np.rint(2e-4 * (stamps - stamps[0])).astype(np.int64)
    assert found_in({"seat": (stamps, samples), "head": (drifted, samples)}).drifts == {}


def test_stamps_of_another_day_are_refused() -> None:
    stamps, samples = made(40.0, shaken(40.0, 0.8))
    far = stamps.copy()
    far[round(20.0 * SEAT_HZ) :] += 40 * 3600 * 10**9
    with pytest.raises(InputError, match="longest_h"):
        found_in({"seat": (far, samples)})


def test_a_session_at_rest_has_no_events() -> None:
    found = found_in({"seat": made(20.0)})
    assert found.events == () and len(found.rests) == 1


def test_a_person_names_conditions_by_time() -> None:
    up = with_shocks(shaken(60.0, 0.5), [30.0])
    found = found_in({"seat": made(60.0, up)})
    named = with_cases(found.events, [CaseSpan(25.0, 35.0, "kerb")])
    assert [event.case for event in named if event.shocks] == ["kerb"] and "kerb_01" in [event.name for event in named]
    assert with_cases(found.events, []) == found.events


@given(st.lists(st.integers(0, 3 * PIECE), max_size=5))
def test_rows_leave_in_pieces_of_one_size(sizes: list[int]) -> None:
    recut, rows = Recut(), np.arange(float(sum(sizes)))[:, None]
    cuts = np.split(rows, np.cumsum(sizes)[:-1]) if sizes else []
    pieces = [piece for part in cuts for piece in recut.push(part)]
    assert {len(piece) for piece in pieces} <= {PIECE}
    left = list(recut.rest())
    assert np.array_equal(np.concatenate([np.empty((0, 1)), *pieces, *left]), rows)


def test_dropped_intervals_stay_away() -> None:
    bins = Bins(0.5, sums=1)
    bins.add(np.array([0.1, 0.6, 1.1, 1.2]), np.array([[1.0], [2.0], [4.0], [6.0]]))
    bins.drop(2)
    bins.add(np.array([0.2, 1.6]), np.array([[9.0], [7.0]]))
    bins.add(np.array([0.2]), np.array([[9.0]]))
    means, counts = bins.means(0, 5)
    assert (
        bins.end == 4 and means.tolist() == [0.0, 0.0, 5.0, 7.0, 0.0] and counts.tolist() == [0.0, 0.0, 2.0, 1.0, 0.0]
    )


def test_bins_are_sums_and_maxima_by_time() -> None:
    bins = Bins(0.5, sums=1, maxima=1)
    time_s = np.array([0.1, 0.2, 1.6])
    bins.add(time_s, np.array([[1.0], [2.0], [4.0]]), np.array([[1.0], [2.0], [4.0]]))
    assert bins.counts.tolist() == [2.0, 0.0, 0.0, 1.0]
    assert bins.sums[:, 0].tolist() == [3.0, 0.0, 0.0, 4.0] and bins.maxima[:, 0].tolist() == [2.0, 0.0, 0.0, 4.0]
    assert bins.extent(0.0, 0.5) == slice(0, 1) and bins.extent(0.3, 9.0) == slice(1, 4)


def test_settings_out_of_range_are_refused() -> None:
    with pytest.raises(InputError, match="shock_g"):
        dataclasses.replace(SessionSettings(), shock_g=0.0)
