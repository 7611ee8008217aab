"""Sittings of the independent simulation: their plan, bags and background."""

import dataclasses
import itertools
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hidden_forms import EVERY, shaken
from mcap.reader import make_reader
from scipy.spatial.transform import Rotation
from world import ride, seats
from world.effects import absorbing, development_forms, event, sitting, wearing
from world.effects.background import NOTHING
from world.effects.draw import KINDS
from world.effects.event import FARTHEST_RAD, HELD_HZ, Event
from world.seats import GRAVITY_MPS2, RATE_HZ

from biodyn_core.body.parameters import LOWER, UPPER, Parameters
from biodyn_core.body.subject import Subject
from biodyn_core.identification.fit import fit_joint
from biodyn_core.identification.phase1 import SwarmSettings
from biodyn_core.identification.problem import Case
from biodyn_core.identification.settings import FitSettings
from biodyn_ros.reading.recordings import read_recordings

QUICK = FitSettings(swarm=SwarmSettings(particles=30, iterations=60, starts=2), evaluations=600)
BRIEF = sitting.Plan(counts=(1, 1, 1), seconds=(1.2, 2.5, 2.5), uses=("fit",), recorded=False)


@cache
def sittings() -> list[sitting.Sitting]:
    """One that hides something in the head's sensor, and one that hides something in a joint; all with `brief_rest`."""
    hidden = (development_forms.GainInMotion(6, 0.1), development_forms.RubbingBackrest(3, 3e3))
    return sitting.drawn(2, 5, plan=BRIEF, chosen=lambda i: hidden[i])


def test_a_sitting_has_the_floor_of_data_for_each_use_and_takes_turns() -> None:
    planned = sitting._planned(sitting.Plan(recorded=False), np.random.default_rng(0))
    for use in sitting.USES:
        own = [one for one in planned if one.use == use]
        assert sum(one.event.motion_s for one in own if one.event.case == "road") >= 30.0
        assert [sum(one.event.case == case for one in own) for case in seats.CASES] == [3, 3, 3]
        assert {one.name for one in own} == {f"{case}_{n}" for case in seats.CASES for n in (1, 2, 3)}
        assert own[-1].event.begin_s > 0.7 * planned[-1].event.whole_s
    begins = [one.event.begin_s for one in planned]
    assert all(b - a >= 2.0 for a, b in itertools.pairwise(begins))
    rails = [one.event.accel_mps2[:, 2] for one in planned if one.event.case == "rail"]
    assert max(abs(np.corrcoef(a, b)[0, 1]) for a, b in itertools.pairwise(rails)) < 0.5


def test_events_are_drawn_again_until_each_use_has_a_hard_one(brief_rest: None) -> None:
    """Potholes have peaks of 1 to 3 g, so an eighth of all draws of three have none of 2 g."""
    free = sitting.Plan(counts=(0, 3, 0), seconds=(0.0, 2.6, 0.0), uses=("fit", "held"), recorded=False)
    hard = dataclasses.replace(free, hardest_mps2=2.0 * GRAVITY_MPS2)
    kept = []
    for seed in range(5):
        once, planned = (sitting._planned(plan, np.random.default_rng(seed)) for plan in (free, hard))
        for use in hard.uses:
            peaks = [np.abs(one.event.accel_mps2[:, 2]).max() for one in planned if one.use == use]
            # A pothole has next to nothing above 100 Hz.
            assert len(peaks) == 3 and max(peaks) > 0.99 * hard.hardest_mps2
        kept.append(np.array_equal(once[0].event.accel_mps2, planned[0].event.accel_mps2))
        assert kept[-1] == hard.is_met(once)
    assert 0 < sum(kept) < len(kept)


def test_with_and_without_are_the_same_but_for_the_effect(brief_rest: None) -> None:
    gain, backrest = sittings()
    for one in (gain, backrest):
        rest = round(event.REST_S[0] * HELD_HZ)
        assert np.abs(one.hidden[0][:rest]).max() < 1e-9
    hidden, plain = gain.streams(0), gain.streams(0, with_effects=False)
    for name in ride.WORN:
        for with_it, without in zip(hidden[name], plain[name], strict=True):
            assert np.array_equal(with_it, without) == (name != "head" or with_it is not hidden["head"][1])
    np.testing.assert_array_equal(gain.hidden[0], gain.plain[0])
    assert np.abs(backrest.hidden[0] - backrest.plain[0]).max() > 0.05
    assert gain.mass_matrix != backrest.mass_matrix


def test_a_sitting_repeats_alone(brief_rest: None) -> None:
    again, first = sitting.draft_of(1, 5, BRIEF, np.random.default_rng([5, 1])), sittings()[1]
    np.testing.assert_array_equal(again.theta, first.theta)
    for one, other in zip(again.events, first.events, strict=True):
        np.testing.assert_array_equal(one.event.accel_mps2, other.event.accel_mps2)


def test_bags_have_six_topics_without_the_truth(brief_rest: None, tmp_path: Path) -> None:
    one = sittings()[1]
    paths = one.write(tmp_path)
    assert [str(path.relative_to(tmp_path)) for path in paths] == [f"fit/{c}_1.mcap" for c in seats.CASES]
    forbidden = {"truth", "effect", "hidden", "blind", "theta", "segment", "cascade", *KINDS}
    forbidden |= {form.__name__ for form in EVERY} | {form.family for form in EVERY if form.family != "sensor"}
    with paths[0].open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        words = " ".join([s.name + s.data.decode() for s in summary.schemas.values()])
        words += " ".join(f"{c.topic} {c.metadata}" for c in summary.channels.values())
        messages = list(reader.iter_messages())
        assert not list(reader.iter_metadata()) and not list(reader.iter_attachments())
        header = reader.get_header()
    assert {c.topic for c in summary.channels.values()} == {f"imu/{name}/data" for name in ride.WORN}
    assert (header.profile, header.library) == ("ros2", "")
    raw = (paths[0].read_bytes() + b"".join(message.data for _, _, message in messages)).lower()
    for word in forbidden:
        assert word.lower() not in words.lower()
        assert len(word) < 5 or word.lower().encode() not in raw, word
    stamps, force, gyro = one.streams(0)["seat"]
    first = next(message for _, channel, message in messages if channel.topic == "imu/seat/data")
    values = np.frombuffer(first.data[20:], "<f8")
    assert first.log_time == sitting.START_NS + round(one.events[0].event.begin_s * 1e9) + stamps[0]
    np.testing.assert_array_equal(values[25:28], force[0])
    np.testing.assert_array_equal(values[13:16], gyro[0])
    assert values[3] == 1.0 and values[4] == -1.0


@pytest.mark.slow
def test_effects_are_scaled_to_the_requested_ratio(brief_rest: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sitting, "GLANCE_S", 1.5)
    one, other = sittings()
    weak = dataclasses.replace(one, effects=(development_forms.LinedHelmet(5, 0.2),), background=other.background)
    (found,) = absorbing.scaled([weak], [0.8])
    assert found.ratio == pytest.approx(0.8, rel=0.3)
    assert found.effects[0].strength > 0.2 and found.truth()["ratio"] == found.ratio


@pytest.mark.slow
def test_the_background_has_the_residual_of_the_paper(tmp_path: Path) -> None:
    plan = sitting.Plan(counts=(0, 1, 1), seconds=(3.0, 3.0, 3.0), uses=("fit",), recorded=False)
    (one,) = sitting.drawn(1, 8, effects=0, plan=plan)
    cases = [Case.of(recording) for path in one.write(tmp_path) for recording in read_recordings(path)]
    assert [case.case for case in cases] == ["pothole", "rail"]
    middle = Parameters.from_vector(0.5 * (LOWER + UPPER))
    fit = fit_joint(cases, Subject("drawn", one.body_mass_kg, 1.75, one.mass_matrix, middle), 0, QUICK)
    percent = np.array([errors.nrmse_rms_percent for errors in fit.errors])
    assert 4.0 < np.median(percent) < 11.0 and percent.min() > 2.0 and percent.max() < 20.0


def test_rates_and_forces_of_a_leaning_sensor_agree() -> None:
    """Its orientation, integrated from its rates, shows gravity where its forces show it."""
    t = np.arange(3 * round(RATE_HZ)) / RATE_HZ
    angle = np.column_stack([0.8 * np.sin(3.0 * t) ** 2, -0.6 * np.sin(2.0 * t) ** 2])
    leaning = Event("road", "synthetic", 0.0, np.zeros((t.size, 3)), angle, 1.0)
    force, spin = wearing.sensed(0, leaning, np.zeros(t[::2].size), (), NOTHING)
    ground = Rotation.from_euler("XY", angle[::2]).apply(force)
    np.testing.assert_allclose(ground, np.broadcast_to([0.0, 0.0, GRAVITY_MPS2], ground.shape), atol=1e-12)
    turns = Rotation.from_rotvec(0.5 * (spin[1:] + spin[:-1]) / HELD_HZ).as_matrix()
    turned = np.array(list(itertools.accumulate(turns, np.matmul)))
    shown = np.einsum("nij,nj->ni", turned, force[1:])
    np.testing.assert_allclose(shown, np.broadcast_to([0.0, 0.0, GRAVITY_MPS2], shown.shape), atol=0.01)
    assert np.abs(force[:, :2]).max() > 5.0


def test_segments_lean_no_farther_than_a_spine_allows() -> None:
    hard = dataclasses.replace(shaken(), accel_mps2=20.0 * shaken().accel_mps2)
    for sensor, farthest in enumerate(FARTHEST_RAD):
        beyond = np.abs(hard.leaning_rad(sensor) - hard.angle_rad).max()
        assert beyond < farthest and (sensor == 0 or beyond > 0.5 * farthest)
