"""Headings of sensors about the vertical, and joints that bend between them."""

import dataclasses
import math
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import optimize, signal
from world.effects import sitting
from world.effects.development_forms import NoddingNeck

from biodyn_core.base.segments import MEASURED_SEGMENTS, SEGMENTS, SENSORS, STANDARD_GRAVITY_MPS2
from biodyn_core.body.model import predict
from biodyn_core.body.parameters import Parameters
from biodyn_core.body.subject import Subject
from biodyn_core.conditioning.channels import Channels
from biodyn_core.conditioning.tilt import horizontal_axes
from biodyn_core.effects import CATALOGUE, AppliedEffect
from biodyn_core.recording.heading import bend_rates_radps, headings_rad
from biodyn_core.recording.recording import Recorder, Recording, RecordingSettings

Floats = NDArray[np.float64]
RATE_HZ = 500.0
SECONDS = 12.0
TURNED = dict(zip(SENSORS, (0.4, -2.9, 1.7, 3.0, -0.8, 2.2), strict=True))
"""Heading of each sensor's x axis in the vehicle, from forward to the left, rad."""


def band(rng: np.random.Generator, columns: int, low_hz: float, high_hz: float, rms: float) -> Floats:
    """Noise (n, columns) of a band, and of an rms."""
    sos = signal.butter(3, [low_hz, high_hz], "bandpass", fs=RATE_HZ, output="sos")
    values = signal.sosfilt(sos, rng.standard_normal((round(SECONDS * RATE_HZ), columns)), axis=0)
    return values / values.std() * rms


def seen(sensor: str, sideways: Floats, lean_rad: Floats) -> Channels:
    """Further channels of a turned sensor, of motion forward and left (n, 2) and roll and pitch (n, 2)."""
    back = np.array([[math.cos(TURNED[sensor]), -math.sin(TURNED[sensor])],
                     [math.sin(TURNED[sensor]), math.cos(TURNED[sensor])]])  # fmt: skip
    roll, pitch = lean_rad.T
    # Nose down, up lies behind; leaning to the right, up lies to the left.
    sensed = sideways + STANDARD_GRAVITY_MPS2 * np.column_stack([-pitch, roll])
    rates = np.gradient(lean_rad, 1.0 / RATE_HZ, axis=0)
    return Channels(sensed @ back, np.column_stack([rates @ back, np.zeros(len(rates))]))


@cache
def leans(nod: float) -> dict[str, Floats]:
    """Roll and pitch of everything: the seat rocks, and each segment nods on its own the more, the higher it is."""
    rng = np.random.default_rng(7)
    rocking = band(rng, 2, 0.5, 5.0, 0.01)
    return {name: rocking + band(rng, 2, 0.5, 4.0, nod * (1 + i)) for i, name in enumerate(SENSORS)}


def sitting_there(sideways_mps2: float = 0.5, sway_mps2: float = 0.05, nod: float = 0.01) -> dict[str, Channels]:
    """A person who goes with the seat, and sways by himself."""
    rng = np.random.default_rng(3)
    shared = band(rng, 2, 0.4, 20.0, sideways_mps2)
    return {name: seen(name, shared + band(rng, 2, 0.4, 20.0, sway_mps2), lean) for name, lean in leans(nod).items()}


def away_rad(found: float, sensor: str) -> float:
    """Error of a heading, rad."""
    return abs(math.remainder(found - (TURNED[sensor] - TURNED["seat"]), 2.0 * math.pi))


def test_every_heading_is_found() -> None:
    found = headings_rad(sitting_there(), RATE_HZ)
    assert tuple(found) == MEASURED_SEGMENTS
    assert max(away_rad(angle, name) for name, angle in found.items()) < 0.1
    assert all(-math.pi <= angle <= math.pi for angle in found.values())


def test_a_gyro_separates_motion_from_gravity() -> None:
    """A head that nods by itself feels more gravity than motion."""
    nodding = sitting_there(nod=0.02)
    blind = {name: dataclasses.replace(one, rates_radps=None) for name, one in nodding.items()}
    with_gyros, without = (headings_rad(one, RATE_HZ) for one in (nodding, blind))
    assert away_rad(with_gyros["head"], "head") < 0.1
    assert "head" not in without


def test_without_gyros_the_heading_of_a_still_head_is_found() -> None:
    found = headings_rad(
        {name: dataclasses.replace(one, rates_radps=None) for name, one in sitting_there(nod=0.0005).items()}, RATE_HZ
    )
    assert tuple(found) == MEASURED_SEGMENTS
    assert max(away_rad(angle, name) for name, angle in found.items()) < 0.1


@pytest.mark.parametrize(("sideways", "sway"), [(0.02, 0.0), (0.0, 0.5)])
def test_too_little_common_motion_gives_no_heading(sideways: float, sway: float) -> None:
    """The leak from the vertical is larger, and independent motion of each sensor gives no heading."""
    assert headings_rad(sitting_there(max(sideways, 1e-9), max(sway, 1e-9), nod=1e-5), RATE_HZ) == {}


def test_a_sensor_without_a_heading_is_skipped() -> None:
    channels = sitting_there()
    lost = seen("neck", band(np.random.default_rng(99), 2, 0.4, 20.0, 0.5), leans(0.01)["neck"])
    found = headings_rad(channels | {"neck": lost}, RATE_HZ)
    assert tuple(found) == ("pelvis", "lower_torso", "upper_torso", "head")
    assert away_rad(found["head"], "head") < 0.1
    nothing = Channels(np.full_like(lost.horizontal_mps2, np.nan), None)
    assert headings_rad(channels | {"neck": nothing}, RATE_HZ) == found
    assert headings_rad(channels | {"seat": nothing}, RATE_HZ) == {} == headings_rad({}, RATE_HZ)


def test_masked_samples_do_not_change_headings() -> None:
    channels = sitting_there()
    found = headings_rad(channels, RATE_HZ)
    horizontal, rates = channels["head"].horizontal_mps2.copy(), channels["head"].rates_radps
    horizontal[1000:1100] = np.nan
    masked = headings_rad(channels | {"head": Channels(horizontal, rates)}, RATE_HZ)
    assert masked["head"] != found["head"] and away_rad(masked["head"], "head") < 0.1


# --- how joints bend -------------------------------------------------------------------------------------------------


def test_the_bending_of_a_joint_is_the_difference_of_tilts_about_the_axes_of_the_seat() -> None:
    channels, lean = sitting_there(), leans(0.01)
    true = {name: TURNED[name] - TURNED["seat"] for name in MEASURED_SEGMENTS}
    found = bend_rates_radps(channels, true)
    assert set(found) == {f"{name}.bend_rate_{axis}" for name in ("neck", "head") for axis in "xy"}
    c, s = math.cos(TURNED["seat"]), math.sin(TURNED["seat"])
    for upper, lower in (("neck", "upper_torso"), ("head", "neck")):
        rates = np.gradient(lean[upper] - lean[lower], 1.0 / RATE_HZ, axis=0)
        np.testing.assert_allclose(found[f"{upper}.bend_rate_x"], rates @ [c, s], atol=1e-12)
        np.testing.assert_allclose(found[f"{upper}.bend_rate_y"], rates @ [-s, c], atol=1e-12)


def test_a_joint_without_two_gyros_and_headings_does_not_bend() -> None:
    channels = sitting_there()
    headings = headings_rad(channels, RATE_HZ)
    blind = channels | {"head": dataclasses.replace(channels["head"], rates_radps=None)}
    assert {name.split(".")[0] for name in bend_rates_radps(blind, headings)} == {"neck"}
    unturned = {name: angle for name, angle in headings.items() if name != "upper_torso"}
    assert {name.split(".")[0] for name in bend_rates_radps(channels, unturned)} == {"head"}
    assert bend_rates_radps(channels, {}) == {}


# --- a record --------------------------------------------------------------------------------------------------------


def recorded(sideways: float = 1.0, channels: bool = True, **settings) -> Recording:
    """Everything goes with the seat, which rests at first; sensors are turned, and lie otherwise as the body."""
    rng = np.random.default_rng(5)
    time_s = np.arange(round(SECONDS * RATE_HZ)) / RATE_HZ
    moving = np.clip(time_s - 3.0, 0.0, 1.0)[:, None]
    accel = moving * np.column_stack([band(rng, 2, 0.5, 20.0, 1.0) * sideways, band(rng, 1, 1.0, 20.0, 2.0)])
    stamps = 1_000_000_000 + np.rint(time_s * 1e9).astype(np.int64)
    recorder = Recorder("road", "drive", settings=RecordingSettings(**settings), channels=channels)
    for name, angle in TURNED.items():
        c, s = math.cos(angle), math.sin(angle)
        axes = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        rates = 0.002 * rng.standard_normal((len(stamps), 3))
        recorder.push(name, stamps, (accel + np.array([0.0, 0.0, STANDARD_GRAVITY_MPS2])) @ axes.T, rates)
    (recording,) = recorder.finish()
    return recording


def test_a_record_reports_headings_and_does_not_turn_axes() -> None:
    recording = recorded()
    assert max(away_rad(angle, name) for name, angle in recording.headings.items()) < 0.02
    assert tuple(recording.headings) == MEASURED_SEGMENTS
    seat, head = (recording.channels[name].horizontal_mps2 for name in ("seat", "head"))
    angle = TURNED["head"] - TURNED["seat"]
    x, y = head.T
    back = np.column_stack([math.cos(angle) * x - math.sin(angle) * y, math.sin(angle) * x + math.cos(angle) * y])
    assert np.nanstd(back - seat) < 0.01 * np.nanstd(seat) < 0.01 * np.nanstd(head - seat)
    assert {"neck.bend_rate_x", "head.bend_rate_y"} <= recording.named_channels().keys()


def test_the_vertical_is_the_same_bit_for_bit_and_a_still_record_turns_nothing() -> None:
    recording = recorded()
    without = recorded(channels=False)
    np.testing.assert_array_equal(recording.measured_mps2, without.measured_mps2)
    np.testing.assert_array_equal(recording.seat_mps2, without.seat_mps2)
    assert without.headings == {}
    still = recorded(sideways=0.0)
    assert still.headings == {}
    assert not any("bend" in name for name in still.named_channels())


# --- a foreign world -------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(("number", "site", "rel", "left"), [(0, "neck", 0.2, 0.95), (1, "head", 0.1, 0.2)])
def test_bending_of_the_independent_simulation_is_recovered_with_length_and_axis(
    number: int, site: str, rel: float, left: float
) -> None:
    """Independent law, integrator, people and mountings: a height L cos phi of the pitch, random headings of sensors.

    The bending of a neck is small; the residual of tilted sensors is larger.
    """
    one, recording = nodding()[number]
    subject = Subject("known", one.body_mass_kg, 1.75, one.mass_matrix, Parameters.from_vector(one.theta))
    begin = round(4.0 * recording.rate_hz)
    measured = recording.measured_mps2[begin:, MEASURED_SEGMENTS.index(site)]
    channels = recording.named_channels()

    def missed(values: Floats) -> Floats:
        length_m, axis_rad = values
        bending = AppliedEffect(CATALOGUE["bending"], site, {"length_m": length_m, "axis_rad": axis_rad})
        bent = dataclasses.replace(subject, effects=(bending,))
        answer = predict(bent, recording.seat_mps2, recording.rate_hz, channels).accel_mps2[:, SEGMENTS.index(site)]
        return np.nan_to_num(answer[begin:] - measured)

    parameters = CATALOGUE["bending"].textbook_parameters
    bounds = [p.lower for p in parameters], [p.upper for p in parameters]
    found = min(
        (optimize.least_squares(missed, (0.2, axis), bounds=bounds) for axis in parameters[1].grid),
        key=lambda one: one.cost,
    )
    axes = one.worn["seat"].axes
    forward = horizontal_axes(tuple(axes[:, 2]))[0] @ axes
    pitch = 0.5 * math.pi - math.atan2(forward[1], forward[0])
    assert found.x[0] == pytest.approx(0.4, rel=rel)
    assert abs(math.remainder(found.x[1] - pitch, math.pi)) < 0.15
    assert found.cost < left * 0.5 * np.sum(missed(np.array([0.0, 0.0])) ** 2)


@cache
def nodding() -> list[tuple[sitting.Sitting, Recording]]:
    """Two people on a rough road, of whom one nods at the neck and one at the head."""
    plan = sitting.Plan(counts=(1, 0, 0), seconds=(8.0, 0.0, 0.0), uses=("fit",), recorded=False)
    people = sitting.drawn(2, 21, effects=1, level=0.0, plan=plan, chosen=lambda i: NoddingNeck(4 + i, 0.4))
    found = []
    for one in people:
        recorder = Recorder("road", "drive", channels=True)
        for sensor, (stamps_ns, *stream) in one.streams(0).items():
            recorder.push(sensor, stamps_ns + sitting.START_NS, *stream)
        (recording,) = recorder.finish()
        found.append((one, recording))
    return found
