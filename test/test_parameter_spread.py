"""The covariance in a subject's file, and the steps that stand for it."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from paper import shipped

from biodyn_core.body.model import Chain
from biodyn_core.body.parameter_spread import (
    NAMES,
    PROVENANCE,
    ParameterSpread,
    largest_steps,
    neighbours,
    parameter_spread,
    reference_motion,
)
from biodyn_core.body.synthesis_settings import NATIVE_RATE_HZ
from biodyn_core.effects import CATALOGUE, AppliedEffect

FITTED = NAMES[:14]


def drawn(seed: int = 1, names: tuple[str, ...] = FITTED) -> ParameterSpread:
    rng = np.random.default_rng(seed)
    root = 0.03 * rng.standard_normal((len(names), len(names)))
    return ParameterSpread(names, root @ root.T)


def test_steps_have_the_covariance() -> None:
    spread = drawn(names=FITTED[2:9])
    steps = spread.steps()
    assert steps.shape == (7, 15)
    np.testing.assert_allclose((steps.T @ steps)[2:9, 2:9], spread.covariance, rtol=1e-9)
    assert np.abs(np.delete(steps, range(2, 9), axis=1)).max() == 0.0
    assert np.all(np.diff(np.linalg.norm(steps, axis=1)) <= 1e-12)


def test_all_the_largest_steps_have_the_covariance_too() -> None:
    spread = drawn()
    steps = largest_steps(shipped("subject_1"), spread, 14)
    np.testing.assert_allclose((steps.T @ steps)[:14, :14], spread.covariance, rtol=1e-6, atol=1e-9)


def test_few_steps_have_nearly_the_whole_effect_of_all() -> None:
    """Variance of the accelerations by four steps beside that of many draws of theta, each chain integrated."""
    subject, spread, rate_hz = shipped("subject_1"), drawn(2), NATIVE_RATE_HZ
    seat = reference_motion()
    nominal = Chain.of(subject).simulate(seat, rate_hz).accel_mps2

    def changes(steps: np.ndarray) -> np.ndarray:
        return np.array([c.simulate(seat, rate_hz).accel_mps2 - nominal for c in neighbours(subject, steps)])

    few = np.sqrt((changes(largest_steps(subject, spread, 4)) ** 2).sum(axis=0).mean(axis=0))
    rng = np.random.default_rng(5)
    draws = np.zeros((60, 15))
    draws[:, :14] = rng.multivariate_normal(np.zeros(14), spread.covariance, 60)
    many = np.sqrt((changes(draws) ** 2).mean(axis=(0, 1)))
    np.testing.assert_allclose(few, many, rtol=0.35)


def test_neighbours_keep_the_effects() -> None:
    cubic = AppliedEffect(CATALOGUE["cubic"], "pelvis", {"cubic_per_m2": 300.0, "exponent": 0.0})
    subject = dataclasses.replace(shipped("subject_1"), effects=(cubic,))
    (chain,) = neighbours(subject, np.zeros((1, 15)))
    assert [element.effect.name for element in chain.elements] == ["cubic"]


def test_the_mapping_is_read_back() -> None:
    spread = drawn()
    found, why = parameter_spread({PROVENANCE: spread.to_dict()})
    assert why == "" and found is not None and found.names == spread.names
    np.testing.assert_array_equal(found.covariance, spread.covariance)


@pytest.mark.parametrize(
    ("given", "why"),
    [
        (None, "has no covariance of its parameters"),
        ([], "needs names of parameters"),
        ({"names": ["knee"], "ln_theta": [[1.0]]}, "needs names of parameters"),
        ({"names": [FITTED[0]] * 2, "ln_theta": [[1.0, 0.0], [0.0, 1.0]]}, "needs names of parameters"),
        ({"names": list(FITTED[:2]), "ln_theta": [[1.0]]}, "needs names of parameters"),
        ({"names": [[1]], "ln_theta": [[1.0]]}, "needs names of parameters"),
        ({"names": list(FITTED[:1]), "ln_theta": [[10**400]]}, "needs names of parameters"),
        ({"names": list(FITTED[:2]), "ln_theta": [[1.0, 0.0], [0.5, 1.0]]}, "needs names of parameters"),
        ({"names": list(FITTED[:2]), "ln_theta": [[1.0, "a"], [0.5, 1.0]]}, "needs names of parameters"),
        ({"names": list(FITTED[:1]), "ln_theta": [[float("nan")]]}, "needs names of parameters"),
        ({"names": list(FITTED[:2]), "ln_theta": [[1.0, 2.0], [2.0, 1.0]]}, "is not positive"),
        ({"names": list(FITTED[:1]), "ln_theta": [[-1.0]]}, "is not positive"),
    ],
)
def test_a_file_without_a_valid_covariance_says_so(given: Any, why: str) -> None:
    found, reason = parameter_spread({} if given is None else {PROVENANCE: given})
    assert found is None and why in reason


def test_a_fitted_parameter_on_a_bound_is_taken_as_known() -> None:
    steps = largest_steps(shipped("subject_1"), drawn(names=FITTED[:3]), 4)
    assert steps.shape == (3, 15) and np.abs(steps[:, 3:]).max() == 0.0
