"""A glance at the catalogue can be kept, and comes back as it was."""

import json
from functools import cache

import hiding
import numpy as np
import pytest

from biodyn_core.base.errors import InputError
from biodyn_core.tracing.answers import answer
from biodyn_core.tracing.preliminary_fit import LEAST_FIT, PreliminaryFits, glance, plain, taken_up
from biodyn_core.tracing.screen import Tried, candidates


def tried() -> list[Tried]:
    return [one for one in candidates(hiding.events(6))[0] if one.applied.effect.name in ("gain", "lift_off")]


@cache
def found() -> PreliminaryFits:
    return glance(hiding.background(hiding.louder, hiding.plain), tried(), 30, 0, lambda stage, share: None)


def test_what_is_hidden_is_in_the_running_and_so_is_lift_off() -> None:
    names = [(one.applied.effect.name, one.applied.site) for one in found().running(1)]
    assert names[0] == ("gain", "neck") and ("lift_off", "pelvis") in names
    assert len(names) == len(set(names))


def test_what_fits_next_to_nothing_is_left_out_but_never_lift_off() -> None:
    fits = {one.tried.applied.site: one.fits for one in found().screening.ladder if one.tried.strength == "gain"}
    (held,) = [one for one in found().screening.ladder if one.tried.applied.effect.name == "lift_off"]
    settled = {(one.applied.effect.name, one.applied.site) for one in found().found}
    most = max(fits.values())
    assert fits["neck"] == most and held.fits < LEAST_FIT * most
    assert ("gain", "neck") in settled and ("gain", "head") in settled and ("lift_off", "pelvis") in settled
    left_out = {site for site in fits if ("gain", site) not in settled}
    assert left_out and left_out == {site for site, one in fits.items() if one < LEAST_FIT * most}


def test_what_a_candidate_fits_is_what_it_takes_off_the_squares() -> None:
    """To first order, by least squares of all the known columns and the candidate's own."""
    background = hiding.background(hiding.louder, hiding.plain)
    best = max(found().screening.ladder, key=lambda one: one.fits)
    products, weight = background.train.products, background.weight
    before = weight @ products.square - (weight @ products.miss) @ background.solved(products)
    matrix, asked = background.normal(), weight @ products.miss
    columns = [
        rows((answer(background.subject, case, (best.tried.applied,)) - answer(background.subject, case))[:, :, None])
        for rows, case in zip(background.train.rows, background.train.cases, strict=True)
    ]
    own = np.concatenate(columns)[:, :, 0]
    known, missed = np.concatenate(background.train.known), np.concatenate(background.train.missed(background.subject))
    cross = np.einsum("w,wr,wrk->k", weight, own, known)
    matrix = np.block([[matrix, cross[:, None]], [cross[None], np.array([[weight @ (own**2).sum(axis=1)]])]])
    asked = np.append(asked, weight @ (own * missed).sum(axis=1))
    after = weight @ products.square - asked @ np.linalg.solve(matrix, asked)
    assert best.fits == pytest.approx(before - after, rel=1e-6)


def test_it_comes_back_from_json_as_it_was() -> None:
    again = taken_up(json.loads(json.dumps(plain(found()))), tried())
    assert [one.gain for one in again.found] == [one.gain for one in found().found]
    assert [one.fits for one in again.screening.ladder] == [one.fits for one in found().screening.ladder]
    assert [dict(one.applied.values) for one in again.found] == [dict(one.applied.values) for one in found().found]
    assert [one.tried.name for one in again.screening.ladder] == [one.tried.name for one in found().screening.ladder]
    np.testing.assert_array_equal(again.screening.chance, found().screening.chance)
    one, other = again.screening.tried[0], again.screening.tried[1]
    assert again.screening.cosine(one, other) == pytest.approx(
        found().screening.cosine(*found().screening.tried[:2]), abs=1e-4
    )


@pytest.mark.parametrize(
    "damage",
    [
        {"ladder": [[999, 0.0, 0.0, 0.0, 0.0, 1.0]]},
        {"ladder": [[0, 0.0, 0.0, 0.0, 1.0]]},
        {"chance": []},
        {"chance": ["x"]},
        {"along": [[1.0]]},
        {"found": [[0, 0.0, 0.0, {"nonsense": 1.0}]]},
        {"found": [[0, 0.0, 0.0, {"gain": 0.05}, 1.0]]},
        {"found": 3},
    ],
)
def test_a_damaged_one_is_refused(damage: dict) -> None:
    with pytest.raises(InputError):
        taken_up(plain(found()) | damage, tried())


def test_one_of_other_candidates_is_refused() -> None:
    with pytest.raises(InputError):
        taken_up(plain(found()), tried()[:3])
