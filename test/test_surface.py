"""The missing force of a joint, in data of another integrator."""

from functools import cache
from unittest import mock

import hiding
import numpy as np
import pytest

from biodyn_core.tracing.findings import Surface
from biodyn_core.tracing.local_fit import fit_locally
from biodyn_core.tracing.nuisance_model import NuisanceModel
from biodyn_core.tracing.surface import force, surface

SEEN = 0.12
"""The required gain."""


def found(law=hiding.plain, change=hiding.nothing, site: str = "pelvis") -> Surface:
    return _found(law, change, site)


@cache
def _found(law, change, site: str) -> Surface:
    nuisance = hiding.nuisance(change, law)
    return surface(nuisance, fit_locally(nuisance, None), site)


def at_no_rate(one: Surface) -> np.ndarray:
    """Force (5,) over the stretch at rest."""
    return one.force_n[1]


def test_the_surface_of_a_stiffening_joint_stiffens() -> None:
    """On roads, about the true body, so that theta explains nothing of it."""
    roads = hiding.events(9, hiding.nothing, hiding.stiffening)[::3]
    nuisance = NuisanceModel.of(hiding.TRUTH, roads[:2], roads[2:])
    push = at_no_rate(surface(nuisance, fit_locally(nuisance, None), "pelvis"))
    # Theta explains the linear part: of a cubic, f(1) - 2 f(1/2) retains three quarters.
    assert push[4] - push[0] - 2.0 * (push[3] - push[1]) > 0.0


def test_a_flat_surface_gains_nothing() -> None:
    nuisance = hiding.nuisance(hiding.nothing, hiding.one_sided)
    flat = mock.patch("biodyn_core.tracing.surface._heights", lambda nuisance, hats: np.zeros(len(hats)))
    with flat:
        assert surface(nuisance, fit_locally(nuisance, None), "pelvis").gain == pytest.approx(0.0, abs=0.02)


def test_the_surface_of_a_joint_stiffer_in_compression_bends_down() -> None:
    one = found(hiding.one_sided)
    push = at_no_rate(one)
    assert one.gain > SEEN
    assert push[0] + push[4] - 2.0 * push[2] < 0.0


def test_the_surface_covers_the_reach_of_the_joint() -> None:
    one = found(hiding.one_sided)
    assert one.force_n.shape == (3, 5) == (one.rate_mps.size, one.stretch_m.size)
    np.testing.assert_allclose(one.stretch_m / one.stretch_m[-1], [-1.0, -0.5, 0.0, 0.5, 1.0])
    np.testing.assert_allclose(one.rate_mps / one.rate_mps[-1], [-1.0, 0.0, 1.0])
    assert 1e-4 < one.stretch_m[-1] < 5e-3  # mm of a seat that gives 1 to 3 mm
    assert np.isfinite(one.force_n[1, 2])


def test_a_sensors_gain_is_no_law_of_a_joint() -> None:
    assert found(hiding.plain, hiding.louder).gain < SEEN


def test_nothing_hidden_is_no_law_of_a_joint() -> None:
    assert abs(found().gain) < SEEN


def test_the_surface_gains_most_at_the_joint_of_the_law() -> None:
    assert found(hiding.one_sided).gain > 2.0 * found(hiding.one_sided, hiding.nothing, "head").gain


def test_hats_are_one_at_their_knot_and_add_up_to_a_plane() -> None:
    knots = [(at, speed) for speed in (-1.0, 0.0, 1.0) for at in (-1.0, -0.5, 0.0, 0.5, 1.0)]
    for at, speed in knots:
        heights = [force(at * 0.01, speed * 0.2, 0.0, 1.0, 0.01, 0.2, *knot) for knot in knots]
        assert heights == [1.0 if knot == (at, speed) else 0.0 for knot in knots]
    rng = np.random.default_rng(2)
    for u, w in rng.uniform(-1.5, 1.5, (50, 2)):
        heights = [force(u * 0.01, w * 0.2, 0.0, 3.0 * at + 2.0 * s, 0.01, 0.2, at, s) for at, s in knots]
        expected = 3.0 * np.clip(u, -1.0, 1.0) + 2.0 * np.clip(w, -1.0, 1.0)
        assert abs(sum(heights) - expected) < 1e-12
