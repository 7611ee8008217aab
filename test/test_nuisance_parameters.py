"""A usual departure takes on what it stands for, at every level."""

import dataclasses

import hiding
import numpy as np
import pytest
from numpy.typing import NDArray

from biodyn_core.identification.problem import Case
from biodyn_core.tracing.local_fit import PRIOR_SCALES, fit_locally
from biodyn_core.tracing.nuisance_model import N_THETA, NuisanceModel, NuisanceSettings
from biodyn_core.tracing.nuisance_parameters import TypicalSettings, nuisance_parameters

LEAK = 0.012


def leaking(case: Case, seed: int) -> Case:
    """What a seat's sensor says that takes its own bias for gravity: forward motion in the vertical."""
    forward, left = 3.0 * np.random.default_rng(seed).standard_normal((2, len(case.seat_mps2)))
    seat_mps2: NDArray[np.float64] = case.seat_mps2 + LEAK * forward
    return dataclasses.replace(case, seat_mps2=seat_mps2, channels={"seat.x": forward, "seat.y": left})


@pytest.fixture(scope="module")
def cases() -> list[Case]:
    return [leaking(case, seed) for seed, case in enumerate(hiding.events(6))]


def settled_by(cases: list[Case], rest_lean: float) -> tuple[dict[str, float], float]:
    """How far each departure went, in its spread, and what is left, for the calmest of bodies."""
    settings = NuisanceSettings(typical=TypicalSettings(rest_lean=rest_lean))
    nuisance = NuisanceModel.of(hiding.fitted(), cases[:3], cases[3:], settings).at_scale(PRIOR_SCALES[-1])
    found = fit_locally(nuisance, None)
    return dict(zip(nuisance.names, found.coefficients[N_THETA:], strict=True)), float(found.residual_square.sum())


def test_a_seat_that_leans_at_rest_is_seen_by_the_whole_body_and_taken_on_at_the_least_level(cases) -> None:
    gone, left = settled_by(cases, 0.008)
    # The prior keeps a share of it back.
    assert -0.008 * gone["lean of seat (x)"] == pytest.approx(LEAK, rel=0.2)
    assert abs(0.008 * gone["lean of seat (y)"]) < 0.1 * LEAK
    assert left < 0.7 * settled_by(cases, 1e-4)[1]


def test_what_every_sensor_has_is_no_smaller_in_a_body_that_departs_in_nothing(cases) -> None:
    nuisance = NuisanceModel.of(hiding.fitted(), cases[:3], cases[3:])
    spread = dict(zip(nuisance.names, nuisance.precision_at(0.1)[N_THETA:] ** -0.5, strict=True))
    assert spread["lean of seat (x)"] == spread["lean of seat (y)"] == 1.0
    assert spread["gain of head"] == spread["mass of neck"] == pytest.approx(0.1)
    assert nuisance.precision_at(1.0) == pytest.approx(nuisance.unit_precision)


def test_without_horizontal_axes_no_seat_leans() -> None:
    plain = hiding.events(3)
    assert not any("lean" in one.name for one in nuisance_parameters(hiding.fitted(), plain))
