"""Preliminary fits: the shortlist, and a checkpoint that is read as it was written."""

import dataclasses
import itertools
import json
from functools import cache

import hiding
import numpy as np
import pytest

from biodyn_core.base.errors import InputError
from biodyn_core.base.parallel import serial_map
from biodyn_core.tracing.answers import answer
from biodyn_core.tracing.candidate import Candidate
from biodyn_core.tracing.preliminary_fit import PreliminaryFits, from_checkpoint, preliminary_fits, to_checkpoint
from biodyn_core.tracing.screen import all_candidates
from biodyn_core.tracing.settings import TraceSettings

SETTINGS = TraceSettings(replicates=30)
LEAST_FIT = SETTINGS.preliminary.least_fit


def tried() -> list[Candidate]:
    return [
        one for one in all_candidates(hiding.TRUTH, hiding.events(6)) if one.start.effect.name in ("gain", "lift_off")
    ]


@cache
def found() -> PreliminaryFits:
    return preliminary_fits(
        hiding.nuisance(hiding.louder, hiding.plain), tried(), 0, lambda stage, share: None, SETTINGS
    )


def test_the_shortlist_has_the_hidden_effect_and_lift_off() -> None:
    names = [one.key for one in found().shortlist(1)]
    assert names[0] == ("gain", "neck") and ("lift_off", "pelvis") in names
    assert len(names) == len(set(names))


def test_candidates_with_a_small_decrease_are_left_out_except_lift_off() -> None:
    ranking = found().screening.ranking
    fits = {one.start.site: one.screened.decrease for one in ranking if one.strength == "gain"}
    (held,) = [one for one in ranking if one.start.effect.name == "lift_off"]
    fitted = {one.key for one in found().candidates}
    most = max(fits.values())
    assert fits["neck"] == most and held.screened.decrease < LEAST_FIT * most
    assert ("gain", "neck") in fitted and ("gain", "head") in fitted and ("lift_off", "pelvis") in fitted
    left_out = {site for site in fits if ("gain", site) not in fitted}
    assert left_out and left_out == {site for site, one in fits.items() if one < LEAST_FIT * most}


def test_the_decrease_is_that_of_the_squares_by_least_squares() -> None:
    """To first order, by least squares of all the known columns and the candidate's own."""
    nuisance = hiding.nuisance(hiding.louder, hiding.plain)
    best = max(found().screening.ranking, key=lambda one: one.screened.decrease)
    products, weight = nuisance.train.products, nuisance.weight
    before = weight @ products.square - (weight @ products.cross) @ nuisance.solution(products)
    matrix, right = nuisance.normal(), weight @ products.cross
    columns = [
        rows((answer(nuisance.subject, case, (best.start,)) - answer(nuisance.subject, case))[:, :, None])
        for rows, case in zip(nuisance.train.rows, nuisance.train.cases, strict=True)
    ]
    own = np.concatenate(columns)[:, :, 0]
    known, residual = np.concatenate(nuisance.train.known), np.concatenate(nuisance.train.residuals(nuisance.subject))
    cross = np.einsum("w,wr,wrk->k", weight, own, known)
    matrix = np.block([[matrix, cross[:, None]], [cross[None], np.array([[weight @ (own**2).sum(axis=1)]])]])
    right = np.append(right, weight @ (own * residual).sum(axis=1))
    after = weight @ products.square - right @ np.linalg.solve(matrix, right)
    assert best.screened.decrease == pytest.approx(before - after, rel=1e-6)


def test_a_checkpoint_is_read_as_it_was_written() -> None:
    again = from_checkpoint(json.loads(json.dumps(to_checkpoint(found()))), tried())
    for one, same in zip(again.candidates, found().candidates, strict=True):
        assert one.tried.gain == same.tried.gain and one.tried.applied.values == same.tried.applied.values
    for one, same in zip(again.screening.ranking, found().screening.ranking, strict=True):
        assert one.screened == same.screened
        assert (one.key, one.strength, one.index) == (same.key, same.strength, same.index)
    np.testing.assert_array_equal(again.screening.chance, found().screening.chance)


@pytest.mark.parametrize(
    "damage",
    [
        {"ranking": [[999, 0.0, 0.0, 0.0, 0.0, 1.0]]},
        {"ranking": [[0, 0.0, 0.0, 0.0, 1.0]]},
        {"chance": []},
        {"chance": ["x"]},
        {"ranking": []},
        {"fits": [[0, 0.0, 0.0, {"nonsense": 1.0}]]},
        {"fits": [[0, 0.0, 0.0, {"gain": 0.05}, 1.0]]},
        {"fits": 3},
    ],
)
def test_a_damaged_checkpoint_is_refused(damage: dict) -> None:
    with pytest.raises(InputError):
        from_checkpoint(to_checkpoint(found()) | damage, tried())


def test_a_checkpoint_of_other_candidates_is_refused() -> None:
    with pytest.raises(InputError):
        from_checkpoint(to_checkpoint(found()), tried()[:3])


def test_an_unstable_fit_is_left_out_and_the_others_stay() -> None:
    shares, (_, *others) = [], found().candidates

    def parallel(stage, function, *given):
        fits = iter(serial_map(stage, function, *given))
        if stage != "preliminary fits":
            return fits
        unstable = dataclasses.replace(next(fits), objective=np.inf)
        return itertools.chain([unstable], fits)

    again = preliminary_fits(
        hiding.nuisance(hiding.louder, hiding.plain), tried(), 0,
        lambda stage, share: shares.append(share) if stage == "preliminary fits" else None, SETTINGS, parallel,
    )  # fmt: skip
    assert [one.key for one in again.candidates] == [one.key for one in others]
    assert [one.tried.gain for one in again.candidates] == [one.tried.gain for one in others]
    assert shares == pytest.approx(np.arange(1, len(others) + 2) / (len(others) + 1))
