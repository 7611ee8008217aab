"""Forces of the joints: equal to mass times acceleration above them, and counted as NumPy counts them."""

from __future__ import annotations

import dataclasses

import naive
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from paper import shipped
from streams import in_turn, independent_streams, noisy_streams, run
from test_model import bodies, half_sine

from biodyn_core.base.arrays import Floats
from biodyn_core.base.segments import SEGMENTS
from biodyn_core.body.model import Chain, parts_of_motion
from biodyn_core.effects import CATALOGUE, AppliedEffect
from biodyn_core.exposure.joint_forces import JOINT_NAMES, JointForceMeter, joint_weights
from biodyn_core.pipeline.pipeline import Pipeline
from biodyn_ros.reports.exposure_report import exposure_report

RATE_HZ = 1129.3
SHOCK = half_sine(4.0, 0.02, 0.6, RATE_HZ)


def above(mass_kg: Floats, accel_mps2: Floats) -> Floats:
    """Mass times absolute acceleration, summed over the segments above each joint, (n, 6)."""
    return np.stack([accel_mps2[:, j:] @ mass_kg[j:] for j in range(6)], axis=1)


@given(bodies)
def test_a_force_is_mass_times_acceleration_above_the_joint(subject) -> None:
    chain = Chain.of(subject)
    found = chain.simulate(SHOCK, RATE_HZ)
    expected = above(chain.inertia_kg, found.accel_mps2)
    np.testing.assert_allclose(found.joint_force_n, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("name", ["cubic", "relaxation", "reflex", "friction"])
def test_effects_in_joints_are_in_their_force(name: str) -> None:
    effect = CATALOGUE[name]
    site = effect.sites[0]
    values = {p.name: p.size for p in effect.parameters}
    chain = Chain.of(dataclasses.replace(shipped("subject_1"), effects=(AppliedEffect(effect, site, values),)))
    found = chain.simulate(SHOCK, RATE_HZ)
    bare = Chain.of(shipped("subject_1")).simulate(SHOCK, RATE_HZ)
    assert np.abs(found.joint_force_n - bare.joint_force_n).max() > 0.05
    expected = above(chain.inertia_kg, found.accel_mps2)
    np.testing.assert_allclose(found.joint_force_n, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


def test_a_backrest_takes_its_force_off_the_joints_below() -> None:
    """The law of the backrest by hand: what it carries is not in the joints below it, and is above none."""
    values = {
        "stiffness_n_per_m": 4000.0,
        "damping_s": 0.02,
        "friction_n": 0.0,
        "smooth_mps": 0.01,
        "cubic_per_m2": 0.0,
    }
    applied = AppliedEffect(CATALOGUE["backrest"], "upper_torso", values)
    chain = Chain.of(dataclasses.replace(shipped("subject_1"), effects=(applied,)))
    found, at = chain.simulate(SHOCK, RATE_HZ), SEGMENTS.index("upper_torso")
    carried = -(4000.0 * found.displacement_m[:, at] + 80.0 * found.velocity_mps[:, at])
    expected = above(chain.inertia_kg, found.accel_mps2)
    expected[:, : at + 1] -= carried[:, None]
    np.testing.assert_allclose(found.joint_force_n, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
    assert np.abs(carried).max() > 10.0


def test_a_seat_that_rises_compresses_every_joint() -> None:
    found = Chain.of(shipped("subject_1")).simulate(half_sine(1.0, 0.5, 0.4, RATE_HZ), RATE_HZ)
    late = round(0.25 * RATE_HZ)
    assert (found.joint_force_n[late] > 0.0).all()
    assert (np.diff(found.joint_force_n[late]) < 0.0).all()


def test_static_weights_are_those_of_the_bodies_above() -> None:
    chain = Chain.of(shipped("subject_1"))
    weights = joint_weights(chain.mass_kg)
    assert weights["pelvis"] == pytest.approx(naive.GRAVITY * chain.mass_kg.sum())
    assert weights["head"] == pytest.approx(naive.GRAVITY * chain.mass_kg[-1])
    assert list(weights) == list(JOINT_NAMES) == list(SEGMENTS)


@given(st.lists(st.integers(0, 900), max_size=8).map(sorted))
def test_the_meter_counts_peaks_and_rms_in_any_cut(cuts: list[int]) -> None:
    rng = np.random.default_rng(5)
    force = 100.0 * rng.standard_normal((900, 2)) + [0.0, 300.0]
    force[rng.uniform(size=900) < 0.05] = np.nan
    meter = JointForceMeter(RATE_HZ, 2, 0.3)
    for part in np.split(force, cuts):
        meter.push(part)
    for column, found in zip(force.T, meter.since_reset(), strict=True):
        there = column[~np.isnan(column)]
        assert found.compression_n == there.max()
        assert found.tension_n == max(0.0, -there.min())
        assert found.rms_n == pytest.approx(np.sqrt(np.mean(there**2)), rel=1e-12)
        assert found.seconds == pytest.approx(there.size / RATE_HZ)
    # Bins of 113 samples: the three bins of the window, and the open one.
    assert meter.rolling()[0].compression_n == np.nanmax(force[(900 // 113 - 3) * 113 :, 0])


# --- in the pipeline -------------------------------------------------------------------------------------------------


def test_figures_of_the_pipeline_are_those_of_its_frames() -> None:
    streams = independent_streams()
    result = run(streams, in_turn(streams))
    force = parts_of_motion(result.motion)[2]
    np.testing.assert_allclose(force, above(Chain.of(result.pipeline.subject).inertia_kg, result.predicted), atol=1e-6)
    for column, name in enumerate(SEGMENTS):
        found = result.exposure.joint_forces[name]
        assert found.compression_n == force[:, column].max() and found.tension_n == -force[:, column].min()
        assert found.rms_n == pytest.approx(np.sqrt(np.mean(force[:, column] ** 2)), rel=1e-9)
    assert result.exposure.joint_forces["pelvis"].compression_n > result.exposure.joint_forces["head"].compression_n


def test_what_effects_hang_on_the_body_weighs_on_its_joints() -> None:
    """A helmet is in the force of the neck, so it is in the weight beside it too, beyond which a body lifts off."""
    helmet = AppliedEffect(CATALOGUE["added_mass"], "head", {"mass_kg": 1.5, "liner_hz": 60.0, "damping_ratio": 0.3})
    organs = AppliedEffect(
        CATALOGUE["viscera"], "lower_torso", {"mass_kg": 5.0, "natural_frequency_hz": 4.5, "damping_ratio": 0.25}
    )
    subject, streams = dataclasses.replace(shipped("subject_1"), effects=(helmet, organs)), noisy_streams()
    result = run(streams, in_turn(streams), pipeline=Pipeline(subject))
    found = exposure_report(result.pipeline).joint_forces
    more_kg = {"pelvis": 6.5, "lower_torso": 6.5, "central_torso": 1.5, "upper_torso": 1.5, "neck": 1.5, "head": 1.5}
    body = joint_weights(Chain.of(subject).mass_kg)
    for name, joint in found.items():
        assert joint.static_n == pytest.approx(body[name] + naive.GRAVITY * more_kg[name])
    assert len(found) == len(SEGMENTS)


def test_a_body_three_times_as_heavy_has_no_forces() -> None:
    streams = noisy_streams()
    result = run(streams, in_turn(streams), pipeline=Pipeline(shipped("subject_1_as_printed")))
    assert result.exposure.joint_forces == {}
    assert np.isnan(parts_of_motion(result.motion)[2]).all()
    assert np.isfinite(parts_of_motion(result.motion)[0]).all()


def test_a_reset_sets_the_forces_to_zero() -> None:
    streams = noisy_streams()
    result = run(streams, in_turn(streams))
    result.pipeline.reset()
    assert result.pipeline.exposure().joint_forces == {}
    assert result.pipeline.exposure(rolling=True).joint_forces["pelvis"].compression_n > 0.0
