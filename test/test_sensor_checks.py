"""Sensors with own clocks, checked by their neighbours: streams of known motion, their bags, and the command."""

from __future__ import annotations

import json
import math
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from listed import assert_listed
from numpy.typing import NDArray

from biodyn_core.base.errors import InputError
from biodyn_core.sensor_pairs.checks import Finding, Recorded, SensorCheck, check_sensor, combined
from biodyn_core.sensor_pairs.faults import PARAMETRIZATIONS, fit_fault, largest_by_chance, size_error
from biodyn_core.sensor_pairs.pairs import PairCheck
from biodyn_core.sensor_pairs.settings import PairSettings, StretchSettings
from biodyn_core.sensor_pairs.streams import Span, Stream, common_spans, pair_of, stream_of
from biodyn_core.sensor_pairs.transfers import Stretch
from biodyn_core.tracing.findings import Verdict
from biodyn_ros.bag import BagWriter
from biodyn_ros.bag.cdr import IMU_TYPE, encode_imu
from biodyn_ros.check_sensors.checking import CheckOptions, Report, SensorPair
from biodyn_ros.check_sensors.evidence import NAMED, RECORDS, UNNAMED
from biodyn_ros.check_sensors.records import RecordOptions
from biodyn_ros.check_sensors.text import text_of
from biodyn_ros.commands.cli import main

Floats = NDArray[np.float64]
Motion = Callable[[Floats], Floats]
Change = Callable[[Floats, Floats], tuple[Floats, Floats]]

ROOT = Path(__file__).resolve().parents[1]
START_NS = 1_767_225_600 * 10**9
SECONDS = 14.0
SHORT = ("--stretch-s", "6", "--stretches", "1", "--replicates", "200")
"""Options that make a run short."""


def motion(seed: int, rms: float = 2.0, most_hz: float = 18.0) -> Motion:
    """Acceleration (n, 3) of a structure at any times (n,): lines of random frequency from 1 Hz on, and gravity."""
    rng = np.random.default_rng(seed)
    hz, phase = rng.uniform(1.0, most_hz, (60, 3)), rng.uniform(0.0, 2.0 * np.pi, (60, 3))
    scale = rms * math.sqrt(2.0 / 60.0)

    def at(time_s: Floats) -> Floats:
        return scale * np.sin(2.0 * np.pi * time_s[:, None, None] * hz + phase).sum(axis=1)

    return at


def neck(time_s: Floats) -> Floats:
    return motion(1)(time_s) + np.array([0.0, 0.0, 9.81])


def still(time_s: Floats) -> Floats:
    return np.full((time_s.size, 3), 5.0)


def head(time_s: Floats) -> Floats:
    """A stiff structure above, with a twentieth of own motion."""
    moved = neck(time_s)
    return moved @ np.array([[1.0, 0.0, 0.1], [0.0, 1.0, 0.0], [0.0, 0.0, 0.95]]) + motion(2, 0.1)(time_s)


def stamps(rate_hz: float, seconds: float = SECONDS, seed: int = 0, begin_s: float = 0.0) -> Floats:
    """Jittered sampling times."""
    count = round(seconds * rate_hz)
    return begin_s + np.arange(count) / rate_hz + 1e-5 * np.random.default_rng(seed).standard_normal(count)


def stream(of: Motion, rate_hz: float, seconds: float = SECONDS, seed: int = 0, begin_s: float = 0.0) -> Stream:
    time_s = stamps(rate_hz, seconds, seed, begin_s)
    return Stream(time_s, of(time_s), None)


def unchanged(time_s: Floats, accel: Floats) -> tuple[Floats, Floats]:
    return time_s, accel


def write_bag(path: Path, change: Change = unchanged, begin_s: float = 0.0, sensors: str = "neck head") -> Path:
    """A bag of both sensors, at 120 and 101 Hz; `change` may alter stamps and samples of the head."""
    with BagWriter(path) as writer:
        for name, of, rate_hz in (("neck", neck, 120.0), ("head", head, 101.0)):
            if name in sensors.split():
                time_s = stamps(rate_hz, begin_s=begin_s)
                stamps_s, accel = change(time_s, of(time_s)) if name == "head" else (time_s, of(time_s))
                stamps_ns = START_NS + np.round(1e9 * stamps_s).astype(np.int64)
                writer.add_topic(f"imu/{name}/data", IMU_TYPE)
                writer.write(f"imu/{name}/data", stamps_ns, encode_imu(stamps_ns, accel, None, "imu"))
    return path


# --- streams ---------------------------------------------------------------------------------------------------------


def test_a_stream_has_no_unset_repeated_or_invalid_samples() -> None:
    stamps_ns = START_NS + np.array([0, 0, 10, 20, 30, 40, 50]) * 1_000_000
    stamps_ns[6] = 0
    accel = np.arange(21.0).reshape(7, 3)
    accel[1], accel[3, 2] = accel[0], math.nan
    found = stream_of(stamps_ns, accel, np.zeros((7, 3)), START_NS)
    np.testing.assert_allclose(found.stamps_s, [0.0, 0.01, 0.03, 0.04])
    np.testing.assert_array_equal(found.accel_mps2, accel[[0, 2, 4, 5]])
    assert found.gyro_radps is None
    with pytest.raises(InputError, match="fewer than three"):
        stream_of(stamps_ns[:3], accel[:3], None, START_NS)
    back = START_NS + np.array([0, 5000, 10, 20]) * 1_000_000
    ahead = START_NS + np.array([0, 10, 20, 10**9]) * 1_000_000
    with pytest.raises(InputError, match="step ahead by 278 h: a clock was set; use --time log"):
        stream_of(ahead, accel[[0, 2, 4, 5]], None, START_NS)
    with pytest.raises(InputError, match="set back"):
        stream_of(back, accel[[0, 2, 4, 5]], None, START_NS)


@pytest.mark.parametrize(("reference_hz", "own_hz", "rate_hz"), [(120.0, 101.0, 101.0), (1129.3, 1127.0, 250.0)])
def test_channels_of_two_clocks_are_on_one_grid(reference_hz: float, own_hz: float, rate_hz: float) -> None:
    one, other = stream(neck, reference_hz, 8.0, 1), stream(head, own_hz, 8.0, 2)
    lost = Stream(np.delete(one.stamps_s, 300), np.delete(one.accel_mps2, 300, axis=0), None)
    pair = pair_of(lost, other, Span(1.0, 7.0), 2, rate_hz, gyro=False)
    at = 1.0 + np.arange(pair.under_test.size) / rate_hz
    inner = slice(20, -20)
    distant = np.abs(at - one.stamps_s[300]) > 0.1
    np.testing.assert_allclose(pair.under_test[inner], head(at)[inner, 2], atol=0.02)
    np.testing.assert_allclose(pair.reference[inner][distant[inner]], neck(at)[inner][distant[inner]], atol=0.02)
    assert pair.own is not None
    np.testing.assert_allclose(pair.own[inner], head(at)[inner, :2], atol=0.02)
    assert not pair.clipped().flags.any()


@pytest.mark.parametrize("seed", [0, 1, 7, 19])
@pytest.mark.parametrize(
    ("jitter_s", "lost"),
    [(0.002, (400,)), (0.002, (200, 300, 800)), (0.003, (600,)), (0.003, (200, 300, 800)), (0.005, ())],
)
def test_jittered_stamps_put_no_sample_in_the_place_of_another(
    jitter_s: float, lost: tuple[int, ...], seed: int
) -> None:
    """The clock of 1250 samples is known to 0.2 ms: 1 % of a motion below 10 Hz; a lost sample is interpolated."""
    even_s = np.arange(1250) / 100.0
    moved = motion(1, most_hz=10.0)
    late_s = jitter_s * np.random.default_rng(seed).standard_normal(even_s.size)
    kept = np.delete(np.arange(even_s.size), lost)
    jittered = Stream(np.sort((even_s + late_s)[kept]), moved(even_s[kept]), None)
    pair = pair_of(jittered, jittered, Span(0.5, 12.0), 2, 100.0, gyro=False)
    true = moved(0.5 + np.arange(pair.under_test.size) / 100.0)[:, 2]
    inner = slice(20, -20)
    assert (pair.under_test - true)[inner].std() < 0.025 * true.std()


def test_clipping_of_raw_samples_survives_resampling() -> None:
    fast = stream(head, 1129.3, 8.0)
    limited = Stream(fast.stamps_s, np.minimum(fast.accel_mps2, 12.0), None)
    clipping = pair_of(stream(neck, 1129.3, 8.0), limited, Span(1.0, 7.0), 2, 250.0, gyro=False).clipped()
    within = (fast.stamps_s >= 1.0) & (fast.stamps_s < 7.0)
    assert clipping.limit_mps2 == 12.0
    assert clipping.count == pytest.approx((limited.accel_mps2[within, 2] == 12.0).sum(), abs=2)
    true = head(1.0 + np.arange(clipping.flags.size) / 250.0)[:, 2] > 12.05
    assert clipping.flags[true].all()
    assert clipping.flags.mean() < 1.5 * true.mean() + 0.02


def test_a_stretch_has_motion_and_no_gap() -> None:
    def moving_late(time_s: Floats) -> Floats:
        return motion(1)(time_s) * np.where(time_s < 20.0, 0.1, 1.0)[:, None] + 9.81

    one, other = stream(moving_late, 100.0, 40.0), stream(head, 100.0, 40.0)
    settings = StretchSettings()
    assert [span.begin_s >= 19.0 for span in common_spans(one, other, 1, 6.0, settings)] == [True]
    assert len(common_spans(one, other, 3, 6.0, settings)) == 3
    gap = (other.stamps_s > 25.0) & (other.stamps_s < 35.0)
    broken = Stream(other.stamps_s[~gap], other.accel_mps2[~gap], None)
    for span in common_spans(one, broken, 3, 6.0, settings):
        assert not span.begin_s < 30.0 < span.end_s


@pytest.mark.parametrize("pause_s", [30.0, 3600.0])
def test_a_pause_of_the_recording_changes_no_rate(pause_s: float) -> None:
    whole = stream(head, 101.0, 40.0)
    paused = whole.stamps_s + np.where(whole.stamps_s > 22.0, pause_s, 0.0)
    assert Stream(paused, whole.accel_mps2, None).rate_hz == pytest.approx(whole.rate_hz, rel=1e-3)


# --- results ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("late_s", "name"), [(0.0, ""), (0.003, "clock")])
def test_a_late_clock_is_found_between_sensors_of_different_rates(late_s: float, name: str) -> None:
    good = Recorded(stream(neck, 120.0, 8.0), stream(head, 101.0, 8.0))
    own = stream(head, 101.0, 8.0, 3, 20.0)
    later = Recorded(stream(neck, 120.0, 8.0, 2, 20.0), Stream(own.stamps_s + late_s, own.accel_mps2, None))
    result = check_sensor(later, [good], 0, StretchSettings(stretches=1), PairSettings(replicates=200))
    found = result.finding
    assert (found.name, result.axis, result.uses_gyro, found.decidable) == (name, "z", False, 1)
    assert result.rate_hz == pytest.approx(101.0, rel=1e-3)
    if name:
        assert found.lower < late_s < found.upper
        assert found.size == pytest.approx(late_s, abs=0.0003)


def test_sensors_that_cannot_be_compared_have_a_reason() -> None:
    good = Recorded(stream(neck, 120.0, 8.0), stream(head, 101.0, 8.0))
    for later, reason in (
        (Recorded(stream(neck, 120.0, 8.0), stream(head, 20.0, 8.0)), "rate of 20.0 Hz is too low"),
        (Recorded(stream(neck, 120.0, 3.0), stream(head, 101.0, 8.0)), "share 3.0 s, at least 5 s"),
        (Recorded(stream(neck, 120.0, 8.0), stream(head, 101.0, 8.0, 0, 100.0)), "do not overlap"),
        (Recorded(stream(neck, 120.0, 8.0), stream(head, 1.0, 8.0)), "rate of 1.0 Hz is too low"),
        (Recorded(stream(still, 120.0, 8.0), stream(still, 101.0, 8.0)), "both sensors give one constant reading"),
    ):
        found = check_sensor(later, [good], 0, StretchSettings(), PairSettings()).finding
        assert found.verdict == "not_decidable"
        assert reason in found.reason


@pytest.mark.parametrize("stuck_s", [18.0, 30.0])
def test_a_sensor_that_is_stuck_in_most_stretches_is_not_without_a_fault(stuck_s: float) -> None:
    def stuck(time_s: Floats) -> Floats:
        return np.where((time_s > 30.0 - stuck_s)[:, None], 5.0, head(time_s))

    good = Recorded(stream(neck, 120.0, 8.0), stream(head, 101.0, 8.0))
    checked = Recorded(stream(neck, 120.0, 30.0), stream(stuck, 101.0, 30.0))
    found = check_sensor(checked, [good], 0, StretchSettings(), PairSettings(replicates=100)).finding
    assert found.verdict == "unexplained" and found.decidable >= 2
    learnt = check_sensor(
        good, [Recorded(good.reference, stream(still, 101.0, 8.0))], 0, StretchSettings(), PairSettings()
    )
    assert learnt.finding.verdict == "not_decidable"
    assert learnt.finding.reason == "in the good recording the sensor gives one constant reading"


def one_check(verdict: Verdict, name: str = "", size: float = 0.0, others: tuple[str, ...] = ()) -> PairCheck:
    return PairCheck(verdict, verdict, name, size, "s", size - 1.0, size + 1.0, others)


def test_the_finding_is_that_of_more_than_half_of_the_decidable_stretches() -> None:
    late = [one_check("effect", "clock", size) for size in (2.0, 4.0, 5.0)]
    none, unknown, clipped = one_check("none"), one_check("not_decidable"), one_check("effect", "saturation", 9.0)
    found = combined([*late, none, unknown])
    assert (found.verdict, found.name, found.agreeing, found.decidable) == ("effect", "clock", 3, 4)
    assert (found.size, found.lower, found.upper) == (4.0, 1.0, 6.0)
    assert combined([late[0], none]).verdict == "unexplained"
    assert combined([late[0], none]).reason == "the stretches differ: clock in 1, none in 1"
    assert combined([unknown, unknown]).verdict == "not_decidable"
    assert combined([none, none, clipped]).name == "saturation"
    growing = combined([one_check("effect", "drift", 1.0), late[0], late[1]])
    assert (growing.verdict, growing.name, growing.ambiguous_with) == ("ambiguous", "clock", ("drift",))


def test_the_standard_error_of_a_gain_is_the_scatter_of_repetitions() -> None:
    rng, count, length = np.random.default_rng(3), 2000, 50
    signal = rng.standard_normal(count)
    sizes, errors = [], []
    for _ in range(60):
        output = 1.05 * signal + 0.2 * np.repeat(rng.uniform(0.5, 1.5, count // length), length) * rng.standard_normal(
            count
        )
        stretch = Stretch(100.0, signal[:, None], output, None, np.ones(count, dtype=np.bool_), length)
        fit = fit_fault(PARAMETRIZATIONS["gain"], stretch, signal, np.ones(count))
        sizes.append(fit.size)
        errors.append(size_error(fit, []))
    assert np.mean(sizes) == pytest.approx(0.05, abs=0.002)
    assert np.mean(errors) == pytest.approx(np.std(sizes), rel=0.25)


def test_the_evidence_equals_the_published_counts() -> None:
    page = (ROOT / "docs/tracing_runs.md").read_text(encoding="utf-8")
    section = page.split("## Faults in measured streams")[1].split("\n## ")[0]
    rows = re.findall(r"^\| (?!\d+ rec|---)(.*) \|$", section, re.MULTILINE)
    cells = [[int(number) for number in re.findall(r"\d+", row.split("|", 1)[1])] for row in rows]
    nothing, above, between, below = cells
    assert sum(row[0] for row in cells) == RECORDS
    alone, among = (sum(row[k] for row in (above, between, below)) for k in (1, 2))
    wrong = nothing[1] + sum(row[3] for row in (above, between, below))
    assert (NAMED.records, NAMED.right, NAMED.right_alone) == (among + wrong, among, alone)
    assert f"in {NAMED.covered} of {NAMED.intervals} records" in section
    for k, verdict in ((4, "none"), (5, "unexplained"), (6, "not_decidable")):
        found = UNNAMED[verdict]  # type: ignore[index]
        counts = (below[k], between[k], above[k])
        assert (found.ratio_below_0_4, found.ratio_0_4_to_0_8, found.ratio_above_0_8) == counts
        assert (found.without_fault, found.records) == (nothing[k - 2], nothing[k - 2] + sum(counts))


def test_a_sensor_between_two_opposite_faults_is_suspected() -> None:
    reading = RecordOptions({}, "header", 600.0)
    options = CheckOptions((), reading, StretchSettings(), PairSettings())
    late, early, more = (Finding("effect", "", "clock", (), size) for size in (0.003, -0.003, 0.002))
    gain = Finding("effect", "", "gain", (), -0.1)
    for lower, upper, named in ((late, early, ("neck",)), (late, more, ()), (late, gain, ())):
        pairs = (SensorPair("neck", "seat"), SensorCheck(lower)), (SensorPair("head", "neck"), SensorCheck(upper))
        report = Report("a", ("b",), 1.0, pairs, (), options)
        assert report.suspects == named
        assert ("neck: its two pairs show opposite faults" in text_of(report)) == bool(named)


# --- the command -----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """good.mcap; late.mcap, whose head is late by 4 ms; only_neck.mcap."""
    at = tmp_path_factory.mktemp("bags")
    write_bag(at / "good.mcap")
    write_bag(at / "late.mcap", lambda time_s, accel: (time_s + 0.004, accel), begin_s=50.0)
    write_bag(at / "only_neck.mcap", begin_s=90.0, sensors="neck")
    shutil.copy(at / "good.mcap", at / "copy.mcap")
    return at


def test_the_command_finds_a_late_sensor(capsys: pytest.CaptureFixture[str], bags: Path) -> None:
    words = ["check-sensors", str(bags / "late.mcap"), "--good", str(bags / "good.mcap"), *SHORT]
    assert main([*words, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert_listed("check-sensors", document)
    (pair,) = document["pairs"]
    assert (pair["sensor"], pair["reference"], pair["fault"], pair["axis"]) == ("head", "neck", "clock", "z")
    assert pair["lower"] < 0.004 < pair["upper"]
    assert pair["size"] == pytest.approx(0.004, abs=0.0004)
    assert len(pair["stretches"]) == 1
    assert main(words) == 0
    out = capsys.readouterr().out
    for text in ("delay", " ms ", "the opposite fault of neck", "of 300 measured records", "neck: no gyro"):
        assert text in out


def test_the_good_part_of_the_bag_itself_is_enough(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    def gain(time_s: Floats, accel: Floats) -> tuple[Floats, Floats]:
        return time_s, np.where(time_s[:, None] < 7.0, 1.0, 1.15) * accel

    bag = str(write_bag(tmp_path / "bag.mcap", gain))
    words = ["check-sensors", bag, "--good-until", "7", "--pair", "imu/head/data=imu/neck/data", *SHORT, "--json"]
    assert main(words) == 0
    (pair,) = json.loads(capsys.readouterr().out)["pairs"]
    assert (pair["fault"], pair["ambiguous_with"], pair["unit"]) == ("gain", [], "")
    assert pair["size"] == pytest.approx(0.15, abs=0.03)


def test_a_clock_that_was_set_within_the_recording_is_stated(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """As by a synchronisation: the seconds after it are compared with nothing."""

    def ahead(time_s: Floats, accel: Floats) -> tuple[Floats, Floats]:
        return time_s + np.where(time_s > 11.0, 400.0, 0.0), accel

    bag = str(write_bag(tmp_path / "bag.mcap", ahead))
    words = ["check-sensors", bag, "--good-until", "5.5", "--pair", "imu/head/data=imu/neck/data", *SHORT, "--json"]
    assert main(words) == 0
    warnings = json.loads(capsys.readouterr().out)["warnings"]
    assert [line for line in warnings if "imu/head/data: no samples from 11.0 to 411.0 s, while another" in line]
    assert not [line for line in warnings if "imu/neck/data: no samples" in line]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("good.mcap", "one of the arguments --good --good-until is required"),
        ("good.mcap --good good.mcap", "the same recording"),
        ("good.mcap --good copy.mcap", "the same recording as good.mcap"),
        ("good.mcap --good late.mcap --good-until 5", "not allowed with"),
        ("good.mcap --good-until 3", "--good-until 3: both parts need 5 s, and the recording is 14.0 s long"),
        ("good.mcap --good only_neck.mcap", "a pair needs two sensors that all bags have"),
        ("good.mcap --good only_neck.mcap --pair head=neck", "only_neck.mcap: it has no sensor or Imu topic head"),
        ("good.mcap --good late.mcap --pair head=nekc", "did you mean neck?"),
        ("good.mcap --good late.mcap --pair head", "--pair head: expected SENSOR=REFERENCE"),
        ("good.mcap --good late.mcap --pair head=head", "two different sensors"),
        ("good.mcap --good late.mcap --pair head=neck head=neck", "given twice"),
        ("good.mcap --good late.mcap --stretch-s 1", "stretch_s is 1, allowed are 5 to 120 s"),
        ("missing.mcap --good good.mcap", "cannot be read"),
    ],
)
def test_bad_input_is_one_line(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, bags: Path, words: str, message: str
) -> None:
    monkeypatch.chdir(bags)
    try:
        code = main(["check-sensors", *words.split()])
    except SystemExit as end:
        code = int(end.code or 0)
    out = capsys.readouterr()
    assert (code, out.out, len(out.err.strip().splitlines())) == (2, "", 1), out.err
    assert message in out.err


def test_a_gyro_counts_if_it_is_finite_and_not_zero_throughout() -> None:
    stamps_ns = START_NS + 10**7 * np.array([0, 2, 1, 3, 3, 4])
    accel = np.arange(18.0).reshape(6, 3)
    accel[4], turning = accel[3], 0.1 * np.arange(18.0).reshape(6, 3)
    found = stream_of(stamps_ns, accel, turning, START_NS)
    np.testing.assert_array_equal(found.gyro_radps, turning[[0, 2, 1, 3, 5]])  # in order, without the repeated one
    np.testing.assert_array_equal(found.accel_mps2, accel[[0, 2, 1, 3, 5]])
    lost = np.where(np.arange(18).reshape(6, 3) == 7, np.nan, turning)
    for gyro in (None, lost, 0.0 * turning):
        assert stream_of(stamps_ns, accel, gyro, START_NS).gyro_radps is None


def test_a_recording_without_a_stretch_free_of_gaps_says_so_and_a_short_stretch_is_the_last_resort() -> None:
    """A gap every 4 s leaves no 5 s; gaps 8 s apart leave none of 12 s, but one of the least length."""
    whole = stream(neck, 100.0, 30.0)

    def with_gaps(every_s: float) -> Recorded:
        kept = whole.stamps_s % every_s > 0.5
        return Recorded(Stream(whole.stamps_s[kept], whole.accel_mps2[kept], None), whole)

    settings, stretches = PairSettings(least_s=5.0, replicates=200), StretchSettings(stretch_s=12.0, stretches=1)
    good = Recorded(whole, stream(head, 100.0, 30.0))
    found = check_sensor(with_gaps(4.0), [good], 0, stretches, settings)
    assert found.finding.verdict == "not_decidable"
    assert found.finding.reason == ("the checked recording: every 5 s have a gap of more than 0.1 s: see biodyn info")
    (one,) = check_sensor(with_gaps(8.0), [good], 0, stretches, settings).checks
    assert one.span.end_s - one.span.begin_s == pytest.approx(5.0)
    assert one.good_span.end_s - one.good_span.begin_s == pytest.approx(12.0)


def test_channels_of_a_gyro_turn_with_its_motion_on_the_grid() -> None:
    time_s = np.arange(1000) / 100.0
    turning = np.column_stack([np.sin(2.0 * np.pi * f * time_s) for f in (1.0, 2.0, 3.0)])
    reference = Stream(time_s, neck(time_s), turning)
    found = pair_of(reference, Stream(time_s, head(time_s), None), Span(1.0, 8.0), 2, 100.0, gyro=True)
    grid_s = 1.0 + np.arange(700) / 100.0
    expected = np.column_stack([np.sin(2.0 * np.pi * f * grid_s) for f in (1.0, 2.0, 3.0)])
    np.testing.assert_allclose(found.reference[20:-20, 3:], expected[20:-20], atol=0.01)
    assert pair_of(reference, reference, Span(1.0, 8.0), 2, 100.0, gyro=False).reference.shape == (700, 3)


def test_candidates_that_are_nowhere_seen_explain_nothing_by_chance() -> None:
    windows, signs = np.array([[1.0, 2.0], [3.0, -4.0]]), np.array([[1.0, 1.0], [1.0, -1.0]])
    # Sums of a draw squared, over the candidate's energy and the residual: (1 + 3)^2 / (2 * 4), (2 + 4)^2 / (3 * 4).
    np.testing.assert_allclose(largest_by_chance(windows, np.array([2.0, 3.0]), 4.0, signs), [2.0, 3.0])
    np.testing.assert_allclose(largest_by_chance(windows, np.array([2.0, 0.0]), 4.0, signs), [2.0, 0.5])
    for energy, residual in ((np.zeros(2), 4.0), (np.array([2.0, 3.0]), 0.0)):
        assert largest_by_chance(windows, energy, residual, signs).tolist() == [0.0, 0.0]
