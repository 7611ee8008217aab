"""A measured seat motion for `biodyn simulate --seat`: what is no motion is refused, what is mended is stated."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from biodyn_core.base.errors import InputError
from biodyn_core.body.synthesis import SeatMotion
from biodyn_ros.bag import BagWriter, imu_blocks, open_bag
from biodyn_ros.bag.cdr import IMU_TYPE, encode_imu
from biodyn_ros.base.topics import INPUT
from biodyn_ros.commands.cli import main
from biodyn_ros.reading.saturation import stated
from biodyn_ros.reading.seat_motion import read_seat_motion

G = 9.80665
RATE_HZ = 500.0
EPOCH_NS = 1_767_225_600 * 10**9
TIME_S = np.arange(5000) / RATE_HZ
UP_MPS2 = 3.0 * np.sin(2.0 * np.pi * 2.0 * TIME_S)
FORCE_MPS2 = np.column_stack([0.0 * TIME_S, 0.0 * TIME_S, G + UP_MPS2])
STAMPS_NS = EPOCH_NS + np.rint(1e9 * TIME_S).astype(np.int64)


def bag_of(path: Path, stamps_ns=STAMPS_NS, force=FORCE_MPS2, gyro=None, limits=None) -> Path:
    """A bag of the seat alone, its messages in the order of the arrays."""
    with BagWriter(path) as writer:
        writer.add_topic(INPUT["seat"], IMU_TYPE)
        logged_ns = EPOCH_NS + np.arange(len(stamps_ns)) * 2_000_000
        writer.write(INPUT["seat"], logged_ns, encode_imu(stamps_ns, force, gyro, "imu"))
        if limits:
            writer.add_metadata("biodyn", stated(limits))
    return path


def table_of(path: Path, header: str, *columns) -> Path:
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=header, comments="")
    return path


def refusal(path: Path) -> str:
    with pytest.raises(InputError) as message:
        read_seat_motion(path, None, {})
    assert "\n" not in str(message.value) and path.name in str(message.value)
    return str(message.value)


def warnings_of(path: Path) -> tuple[list[str], float, float]:
    """The warnings, the rate in Hz and the vertical rms."""
    lines: list[str] = []
    motion = read_seat_motion(path, None, {}, warn=lines.append)
    return lines, motion.rate_hz, float(motion.accel_mps2[:, 2].std())


def test_a_clean_motion_has_no_warning(tmp_path: Path) -> None:
    for path in (
        bag_of(tmp_path / "a.mcap"),
        table_of(tmp_path / "a.csv", "t,ax,ay,az", TIME_S, FORCE_MPS2),
        table_of(tmp_path / "b.csv", "t,az", TIME_S, G + UP_MPS2),
        table_of(tmp_path / "c.csv", "t,az", TIME_S, UP_MPS2),
        table_of(tmp_path / "d.csv", "t,ax,ay,az", TIME_S, FORCE_MPS2 - [0.0, 0.0, G]),
    ):
        lines, rate_hz, rms = warnings_of(path)
        assert lines == [] and rate_hz == pytest.approx(RATE_HZ) and rms == pytest.approx(2.121, abs=0.01)


@pytest.mark.parametrize(
    ("name", "unit_s"),
    [("time_ms", 1e-3), ("t_us", 1e-6), ("timestamp_ns", 1e-9), ("t [ms]", 1e-3), ("Time (us)", 1e-6)],
)
def test_a_time_column_has_the_unit_of_its_name(tmp_path: Path, name: str, unit_s: float) -> None:
    path = table_of(tmp_path / "a.csv", f"{name},az", np.round((1e9 + TIME_S) / unit_s), UP_MPS2)
    lines, rate_hz, rms = warnings_of(path)
    assert lines == [] and rate_hz == pytest.approx(RATE_HZ, rel=1e-3) and rms == pytest.approx(2.121, abs=0.01)


@pytest.mark.parametrize("by_s", [20.0, 0.5, -20.0, -0.5])
def test_a_stray_stamp_is_refused(tmp_path: Path, by_s: float) -> None:
    stamps = STAMPS_NS.copy()
    stamps[2000] += round(1e9 * by_s)
    line = refusal(bag_of(tmp_path / "a.mcap", stamps))
    back_s = abs(by_s) - 0.002  # from the stray stamp, or to it
    assert f"time goes back by {back_s:.4g} s at sample {2002 if by_s > 0 else 2001} of 5000" in line
    assert "at most 0.2 s is allowed: try --time log" in line
    time_s = 1e-9 * (stamps - EPOCH_NS)
    assert "correct the time column" in refusal(table_of(tmp_path / "a.csv", "t,az", time_s, UP_MPS2))


def test_a_stamp_that_was_never_set_is_refused(tmp_path: Path) -> None:
    stamps = STAMPS_NS.copy()
    stamps[0] = 0
    assert "a gap of 1.767e+09 s begins 0.000 s" in refusal(bag_of(tmp_path / "a.mcap", stamps))


def test_a_gap_is_refused_and_a_short_one_stated(tmp_path: Path) -> None:
    long, short = (TIME_S < 2.0) | (TIME_S > 5.0), (TIME_S < 2.0) | (TIME_S > 2.1)
    line = refusal(bag_of(tmp_path / "a.mcap", STAMPS_NS[long], FORCE_MPS2[long]))
    assert "a gap of 3.004 s begins 1.998 s after the first sample, at most 0.2 s is allowed" in line
    lines, rate_hz, _ = warnings_of(bag_of(tmp_path / "b.mcap", STAMPS_NS[short], FORCE_MPS2[short]))
    assert len(lines) == 1 and "1 gap of up to 104 ms, bridged by straight lines" in lines[0]
    assert rate_hz == pytest.approx(RATE_HZ, rel=0.011)


def test_a_gap_is_named_where_it_makes_the_mean_rate_low(tmp_path: Path) -> None:
    slow = np.flatnonzero((TIME_S < 2.0) | (TIME_S > 8.0))[::20]  # 25 Hz
    assert "a gap of 6" in refusal(bag_of(tmp_path / "a.mcap", STAMPS_NS[slow], FORCE_MPS2[slow]))
    assert "a rate of 5 Hz is too low" in refusal(bag_of(tmp_path / "b.mcap", STAMPS_NS[::100], FORCE_MPS2[::100]))


def test_samples_out_of_order_are_sorted(tmp_path: Path) -> None:
    mixed = np.arange(5000).reshape(-1, 8)[:, np.random.default_rng(0).permutation(8)].ravel()
    lines, rate_hz, rms = warnings_of(bag_of(tmp_path / "a.mcap", STAMPS_NS[mixed], FORCE_MPS2[mixed]))
    assert len(lines) == 1 and "samples are out of order and sorted by time" in lines[0]
    straight = read_seat_motion(bag_of(tmp_path / "b.mcap"), None, {})
    assert rate_hz == pytest.approx(RATE_HZ) and rms == pytest.approx(straight.accel_mps2[:, 2].std())


def test_repeated_stamps_are_stated(tmp_path: Path) -> None:
    stamps = STAMPS_NS.copy()
    stamps[100] = stamps[99]
    lines, _, _ = warnings_of(bag_of(tmp_path / "a.mcap", stamps))
    assert len(lines) == 1 and "1 sample has the time of another one and left out" in lines[0]


@pytest.mark.parametrize(("unit", "one"), [("g", G), ("mg", 1e-3 * G)])
def test_units_of_g_are_refused(tmp_path: Path, unit: str, one: float) -> None:
    words = f"so the values are in {unit}: m/s^2 are needed"
    assert words in refusal(bag_of(tmp_path / "a.mcap", force=FORCE_MPS2 / one))
    assert words in refusal(table_of(tmp_path / "a.csv", "t,az", TIME_S, FORCE_MPS2[:, 2] / one))
    assert words in refusal(table_of(tmp_path / "b.csv", "t,a_down", TIME_S, -FORCE_MPS2[:, 2] / one))
    assert words in refusal(table_of(tmp_path / "c.csv", "t,ax,ay,az", TIME_S, FORCE_MPS2 / one))


def test_a_mean_that_is_neither_gravity_nor_zero_is_stated(tmp_path: Path) -> None:
    lines, _, _ = warnings_of(table_of(tmp_path / "a.csv", "t,az", TIME_S, 0.7 * FORCE_MPS2[:, 2]))
    assert len(lines) == 1 and "the mean acceleration is 6.86 m/s^2, neither gravity nor zero" in lines[0]


@pytest.mark.parametrize(
    ("header", "both"),
    [
        ("t,ax,ay,az,x,y,z", "ax and x"), ("t,x,y,z,ax,ay,az", "x and ax"), ("t,az,z", "az and z"),
        ("t,a_up,up", "a_up and up"), ("t,az,up", "az and up"), ("t,a_left,a_right,az", "a_left and a_right"),
    ],
)  # fmt: skip
def test_two_columns_of_one_axis_are_refused(tmp_path: Path, header: str, both: str) -> None:
    columns = [TIME_S, *(UP_MPS2 for _ in header.split(",")[1:])]
    assert f"{both} name one axis: remove or rename one of them" in refusal(
        table_of(tmp_path / "a.csv", header, *columns)
    )


def test_readings_beyond_any_sensor_are_refused(tmp_path: Path) -> None:
    force = FORCE_MPS2.copy()
    force[3000:3003] = [1e9, 0.0, 1e9]
    words = "3 samples are beyond 1568 m/s^2, the first 6.000 s after the begin"
    assert words in refusal(bag_of(tmp_path / "a.mcap", force=force))
    assert words in refusal(table_of(tmp_path / "a.csv", "t,ax,ay,az", TIME_S, force))


def test_a_bag_of_a_wider_sensor_may_read_more(tmp_path: Path) -> None:
    force = FORCE_MPS2.copy()
    force[3000, 2] = 1900.0
    assert "1 sample is beyond 1568 m/s^2" in refusal(bag_of(tmp_path / "a.mcap", force=force))
    lines, _, _ = warnings_of(bag_of(tmp_path / "b.mcap", force=force, limits={INPUT["seat"]: 1951.0}))
    assert lines == []


def test_angular_rates_that_are_no_measurement_are_zero_and_stated(tmp_path: Path) -> None:
    gyro = np.tile([0.0, 0.1, 0.0], (5000, 1))
    gyro[10:12] = [0.0, 1e9, np.nan]
    lines: list[str] = []
    motion = read_seat_motion(bag_of(tmp_path / "a.mcap", gyro=gyro), None, {}, warn=lines.append)
    assert len(lines) == 1 and "2 angular rates are no measurement and taken as zero" in lines[0]
    assert np.abs(motion.pitch_rate_radps).max() == pytest.approx(0.1)


def test_a_log_time_that_replaces_unset_stamps_is_stated(tmp_path: Path) -> None:
    lines, rate_hz, _ = warnings_of(bag_of(tmp_path / "a.mcap", 0 * STAMPS_NS))
    assert len(lines) == 1 and "header stamps are zero: log time is used instead" in lines[0]
    assert rate_hz == pytest.approx(RATE_HZ)


# --- times -----------------------------------------------------------------------------------------------------------

SLOW_HZ = 50.0
SLOW_S = np.arange(2000) / SLOW_HZ


def tones_mps2(time_s):
    """Five tones up to 0.36 of SLOW_HZ, of one size."""
    return sum(np.sin(2.0 * np.pi * hz * time_s + hz) for hz in (1.3, 4.7, 9.1, 13.9, 18.0))


def error_of(path: Path, times_s) -> float:
    """Error of the tones in percent of their rms, after reading samples at these times."""
    motion = read_seat_motion(table_of(path, "t,az", times_s, G + tones_mps2(times_s)), None, {})
    wanted = tones_mps2(times_s[0] + np.arange(len(motion.accel_mps2)) / motion.rate_hz)
    wanted -= wanted.mean()
    return 100.0 * float(np.std(motion.accel_mps2[:, 2] - wanted) / np.std(wanted))


def test_even_samples_are_kept_as_they_are(tmp_path: Path) -> None:
    motion = read_seat_motion(table_of(tmp_path / "a.csv", "t,az", TIME_S, G + UP_MPS2), None, {})
    np.testing.assert_allclose(motion.accel_mps2[:, 2], UP_MPS2 - UP_MPS2.mean(), rtol=0.0, atol=1e-9)
    assert motion.rate_hz == pytest.approx(RATE_HZ, rel=1e-12)


@pytest.mark.parametrize(("lost", "percent"), [(0, 0.01), (1, 2.0), (2, 5.0)])
def test_lost_samples_cost_little(tmp_path: Path, lost: int, percent: float) -> None:
    times_s = np.delete(SLOW_S, np.arange(1000, 1000 + lost))
    assert error_of(tmp_path / "a.csv", times_s) < percent  # straight lines at the mean rate: 23 %


def test_jitter_of_real_sampling_times_costs_little(tmp_path: Path) -> None:
    times_s = SLOW_S + 0.3 / SLOW_HZ * np.random.default_rng(1).uniform(-1.0, 1.0, SLOW_S.size)
    assert error_of(tmp_path / "a.csv", times_s) < 8.0  # straight lines: 21 %


def test_a_stated_gap_is_a_straight_line(tmp_path: Path) -> None:
    there = (SLOW_S < 10.0) | (SLOW_S > 10.1)
    times_s = SLOW_S[there]
    path = table_of(tmp_path / "a.csv", "t,az", times_s, G + 10.0 * np.sin(2.0 * np.pi * 3.0 * times_s))
    lines: list[str] = []
    motion = read_seat_motion(path, None, {}, warn=lines.append)
    assert len(lines) == 1 and "1 gap of up to 140 ms, bridged by straight lines" in lines[0]
    at_s = np.arange(len(motion.accel_mps2)) / motion.rate_hz
    inside = motion.accel_mps2[(at_s > 9.98) & (at_s < 10.12), 2]
    assert inside.size >= 6 and np.abs(np.diff(inside, 2)).max() < 1e-9
    outside = (at_s < 9.98) | (at_s > 10.12)
    wanted = 10.0 * np.sin(2.0 * np.pi * 3.0 * at_s[outside])
    np.testing.assert_allclose(np.diff(motion.accel_mps2[outside, 2] - wanted), 0.0, atol=0.05)


def test_a_short_gap_of_a_fast_sensor_is_stated(tmp_path: Path) -> None:
    """A spline through 30 ms without samples between samples of 2 ms may swing."""
    there = (TIME_S < 2.0) | (TIME_S > 2.03)
    lines, _, _ = warnings_of(table_of(tmp_path / "a.csv", "t,az", TIME_S[there], UP_MPS2[there]))
    assert len(lines) == 1 and "1 gap of up to 34 ms, bridged by straight lines" in lines[0]


def test_samples_with_nearly_one_stamp_do_not_make_the_motion_swing(tmp_path: Path) -> None:
    times_s = SLOW_S.copy()
    times_s[500::500] = times_s[499:-1:500] + 0.01 / SLOW_HZ
    lines: list[str] = []
    path = table_of(tmp_path / "a.csv", "t,az", times_s, G + tones_mps2(SLOW_S))
    motion = read_seat_motion(path, None, {}, warn=lines.append)
    assert len(lines) == 1
    assert "3 samples follow a sample by less than 0.25 of a sampling period and left out" in lines[0]
    assert np.abs(motion.accel_mps2[:, 2]).max() < 1.2 * np.abs(tones_mps2(SLOW_S)).max()


# --- one column ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "mean", "sign", "stated"),
    [
        ("az", G, 1, False), ("az", -G, -1, True), ("a_down", -G, -1, False), ("a_down", G, 1, True),
        ("az", 0.0, 1, False), ("a_down", 0.0, -1, False), ("acc", -G, -1, True), ("az", -0.4, 1, False),
    ],
)  # fmt: skip
def test_gravity_gives_the_sign_of_one_column(tmp_path: Path, name: str, mean: float, sign: int, stated: bool) -> None:
    saw_mps2 = 20.0 * (TIME_S % 0.5) ** 2  # up and down differ
    lines: list[str] = []
    path = table_of(tmp_path / "a.csv", f"t,{name}", TIME_S, mean + saw_mps2 - saw_mps2.mean())
    motion = read_seat_motion(path, None, {}, warn=lines.append)
    np.testing.assert_allclose(motion.accel_mps2[:, 2], sign * (saw_mps2 - saw_mps2.mean()), atol=1e-6)
    words = f"a.csv: {name}: gravity shows that the axis points the other way than its name states"
    assert [words in line for line in lines] == [True] * stated


@pytest.mark.parametrize("name", ["a_forward", "ax", "x", "ay", "y", "left", "acc_right [m/s^2]"])
def test_one_horizontal_column_is_refused(tmp_path: Path, name: str) -> None:
    line = refusal(table_of(tmp_path / "a.csv", f"t,{name}", TIME_S, UP_MPS2))
    assert f"a.csv: {name}, the only acceleration column, is horizontal by its name" in line
    assert "a vertical one (az, a_up or a_down) or three columns (ax, ay, az) are needed" in line


# --- ends ------------------------------------------------------------------------------------------------------------

EXACT = [
    word
    for name in (
        "tilt-deg", "noise-mps2", "bias-mps2", "gyro-noise-radps", "clock-offset-ms", "clock-drift-ppm", "jitter-ms",
    )
    for word in (f"--{name}", "0")
]  # fmt: skip


@pytest.mark.parametrize("rate_hz", [1000.0, 4517.2])
@pytest.mark.parametrize("begin_s", [0.02, 2.5, 4.9])
def test_a_motion_arrives_whole_and_at_its_times(tmp_path: Path, begin_s: float, rate_hz: float) -> None:
    """A half-sine of 50 m/s^2 and 80 ms, also near an end of the record."""

    def up_mps2(time_s):
        shock = 50.0 * np.sin(np.pi * (time_s - begin_s) / 0.08)
        return 2.0 * np.cos(2.0 * np.pi * 3.0 * time_s) + np.where(abs(time_s - begin_s - 0.04) < 0.04, shock, 0.0)

    at_s = np.arange(round(5.0 * rate_hz)) / rate_hz
    seat, bag = table_of(tmp_path / "seat.csv", "t,az", at_s, G + up_mps2(at_s)), tmp_path / "out.mcap"
    assert main(["simulate", "--subject", "subject_1", "--seat", str(seat), "-o", str(bag), *EXACT]) == 0
    with open_bag(bag) as reader:
        blocks = [block for _, block in imu_blocks(reader, [INPUT["seat"]], "header")]
    found = np.concatenate([block.accel_mps2 for block in blocks])[:, 2] - G
    time_s = 1e-9 * (np.concatenate([block.stamps_ns for block in blocks]) - EPOCH_NS)
    ride_s = time_s - (0.1 + 1.0 + 0.25)  # the record begins 0.1 s after the epoch, then come rest and the rise
    within = (ride_s >= 0.0) & (ride_s <= at_s[-1])
    assert within.sum() == pytest.approx(5.0 * 1129.3, abs=3)
    wanted = up_mps2(ride_s[within]) - up_mps2(at_s).mean()
    np.testing.assert_allclose(found[within], wanted, atol=0.35)  # steepest slope: 1963 m/s^3
    assert np.abs(found[ride_s < -0.26]).max() < 0.01 and np.abs(found[ride_s > at_s[-1] + 0.26]).max() < 0.01
    assert np.abs(np.diff(found)).max() < 2.2  # no step: the half-sine has 1.9 between samples


def test_a_motion_that_is_cut_rises_from_zero_and_returns_to_it() -> None:
    motion = SeatMotion(100.0, np.full((400, 3), 8.0), np.full(400, 0.5)).first(3.0).from_rest()
    assert motion.seconds == pytest.approx(3.0 + 2.0 * 0.25)
    np.testing.assert_array_equal(motion.accel_mps2[25:325], 8.0)
    np.testing.assert_array_equal(motion.pitch_rate_radps[25:325], 0.5)
    for column in (*motion.accel_mps2.T / 8.0, motion.pitch_rate_radps / 0.5):
        assert column[0] == column[-1] == 0.0 and np.abs(np.diff(column)).max() < 0.07
        np.testing.assert_array_equal(column, column[::-1])


def test_the_command_prints_warnings_and_refusals(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    stamps = STAMPS_NS.copy()
    stamps[100] = stamps[99]
    words = ["simulate", "--subject", "subject_1", "--seconds", "2", "-o", str(tmp_path / "out.mcap"), "--seat"]
    assert main([*words, str(bag_of(tmp_path / "a.mcap", stamps))]) == 0
    assert "biodyn simulate: warning: " in capsys.readouterr().err
    stamps[2000:] += 10**10
    (tmp_path / "out.mcap").unlink()
    assert main([*words, str(bag_of(tmp_path / "b.mcap", stamps))]) == 2
    message = capsys.readouterr().err
    assert message.count("\n") == 1 and "a gap of 10 s" in message and not (tmp_path / "out.mcap").exists()
