"""Nuisance parameters explain their own deviation at every prior scale."""

import dataclasses

import hiding
import numpy as np
import pytest
from numpy.typing import NDArray

from biodyn_core.identification.problem import Case
from biodyn_core.tracing.local_fit import fit_locally
from biodyn_core.tracing.nuisance_model import N_THETA, NuisanceModel, NuisanceSettings
from biodyn_core.tracing.nuisance_parameters import TypicalSettings, nuisance_parameters
from biodyn_core.tracing.settings import LocalFitSettings

LEAK = 0.012
LEAST_SCALE = min(LocalFitSettings().prior_scales)


def leaking(case: Case, seed: int) -> Case:
    """A seat sensor tilted by its bias at rest: forward motion appears in the vertical."""
    forward, left = 3.0 * np.random.default_rng(seed).standard_normal((2, len(case.seat_mps2)))
    seat_mps2: NDArray[np.float64] = case.seat_mps2 + LEAK * forward
    return dataclasses.replace(case, seat_mps2=seat_mps2, channels={"seat.x": forward, "seat.y": left})


@pytest.fixture(scope="module")
def cases() -> list[Case]:
    return [leaking(case, seed) for seed, case in enumerate(hiding.events(6))]


def fitted_with(cases: list[Case], rest_lean: float) -> tuple[dict[str, float], float]:
    """Each nuisance parameter in typical spreads, and the squared residual, at the least prior scale."""
    settings = NuisanceSettings(typical=TypicalSettings(rest_lean=rest_lean))
    nuisance = NuisanceModel.of(hiding.fitted(), cases[:3], cases[3:], settings).at_scale(LEAST_SCALE)
    found = fit_locally(nuisance, None)
    return dict(zip(nuisance.names, found.coefficients[N_THETA:], strict=True)), float(found.residual_square.sum())


def test_a_tilted_seat_is_fitted_even_at_the_least_prior_scale(cases) -> None:
    gone, left = fitted_with(cases, 0.008)
    # The prior reduces it a little.
    assert -0.008 * gone["tilt of seat (x)"] == pytest.approx(LEAK, rel=0.2)
    assert abs(0.008 * gone["tilt of seat (y)"]) < 0.1 * LEAK
    assert left < 0.7 * fitted_with(cases, 1e-4)[1]


def test_the_tilt_at_rest_keeps_its_spread_at_the_least_prior_scale(cases) -> None:
    nuisance = NuisanceModel.of(hiding.fitted(), cases[:3], cases[3:])
    spread = dict(zip(nuisance.names, nuisance.precision_at(0.1)[N_THETA:] ** -0.5, strict=True))
    assert spread["tilt of seat (x)"] == spread["tilt of seat (y)"] == 1.0
    assert spread["gain of head"] == spread["mass of neck"] == pytest.approx(0.1)
    assert nuisance.precision_at(1.0) == pytest.approx(nuisance.unit_precision)


def test_without_horizontal_axes_there_is_no_tilt_of_the_seat() -> None:
    plain = hiding.events(3)
    assert not any("tilt of" in one.name for one in nuisance_parameters(hiding.fitted(), plain))


def test_a_sensor_with_horizontal_axes_has_a_tilt_about_both_and_every_deviation_its_site(cases) -> None:
    with_head = [
        dataclasses.replace(one, channels={**one.channels, "head.x": one.seat_mps2, "head.y": one.seat_mps2})
        for one in cases
    ]
    found, before = (nuisance_parameters(hiding.fitted(), one) for one in (with_head, cases))
    tilts = {one.name: one for one in found if one.name not in {other.name for other in before}}
    assert set(tilts) == {"tilt of head (lean_x)", "tilt of head (lean_y)"}
    s = TypicalSettings()
    for axis, one in (("lean_x", tilts["tilt of head (lean_x)"]), ("lean_y", tilts["tilt of head (lean_y)"])):
        assert list(one.strengths) == [axis] and one.spread * one.strengths[axis] == pytest.approx(s.usual_lean)
        assert one.least_scale == pytest.approx(s.rest_lean / s.usual_lean)
    for one in found:
        assert one.name.split(" of ")[1].split(" (")[0] == one.site
