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
from biodyn_core.tracing.preliminary_fit import (
    PreliminaryFits,
    _selected,
    from_checkpoint,
    preliminary_fits,
    to_checkpoint,
)
from biodyn_core.tracing.screen import all_candidates
from biodyn_core.tracing.settings import TraceSettings

SETTINGS = TraceSettings(replicates=30)
LEAST_FIT = SETTINGS.preliminary.least_fit


def tried(*names: str) -> list[Candidate]:
    return [
        one
        for one in all_candidates(hiding.TRUTH, hiding.events(6))
        if one.start.effect.name in (names or ("gain", "lift_off"))
    ]


@cache
def found() -> PreliminaryFits:
    return preliminary_fits(
        hiding.nuisance(hiding.louder, hiding.plain), tried(), 0, lambda stage, share: None, SETTINGS
    )


@cache
def bent(generalised: int = 12) -> PreliminaryFits:
    """A body whose seat's joint is stiffer in compression, which bends in another way than the textbook form."""
    preliminary = dataclasses.replace(SETTINGS.preliminary, generalised=generalised)
    settings = dataclasses.replace(SETTINGS, preliminary=preliminary)
    nuisance = hiding.nuisance(law=hiding.one_sided)
    return preliminary_fits(nuisance, tried("asymmetry", "gain"), 0, lambda stage, share: None, settings)


def test_the_general_form_gains_more_where_the_law_is_no_textbook_form() -> None:
    best, *_ = bent().shortlist(1)
    assert best.key == ("asymmetry", "pelvis") and best.start.is_textbook
    textbook, general = best.all_tried
    assert general.gain > textbook.gain + 0.05 and general.decrease > textbook.decrease
    assert general.applied.values["exponent"] < -0.5 and textbook.applied.values["exponent"] == 0.0


def test_only_the_first_candidates_have_a_fit_of_the_general_form() -> None:
    """... by their decrease to first order; an effect without one has none."""
    first = max(bent().screening.ranking, key=lambda one: one.screened.decrease).key
    assert {one.key for one in bent(1).candidates if one.preliminary_general is not None} == {first}
    assert all(one.preliminary_general is None for one in bent(0).candidates)
    assert all(one.preliminary_general is None for one in bent().candidates if one.start.effect.name == "gain")


def test_a_shape_of_the_general_form_selects_its_effect() -> None:
    """Where the textbook form alone decreases the objective too little."""
    screening = bent().screening
    for_asymmetry = [one for one in screening.ranking if one.key == ("asymmetry", "pelvis")]
    small = [
        dataclasses.replace(one, screening=dataclasses.replace(one.screened, decrease=0.0))
        if one.start.is_textbook else one
        for one in screening.ranking
    ]  # fmt: skip
    chosen = _selected(dataclasses.replace(screening, ranking=tuple(small)), SETTINGS.preliminary)
    (textbook, best) = next(pair for pair in chosen if pair[0].key == ("asymmetry", "pelvis"))
    assert textbook.start.is_textbook and not best.start.is_textbook and len(for_asymmetry) == 3


def test_the_shortlist_has_the_hidden_effect_and_lift_off() -> None:
    names = [one.key for one in found().shortlist(1)]
    assert names[0] == ("gain", "neck") and ("lift_off", "pelvis") in names
    assert len(names) == len(set(names))


def test_candidates_with_a_small_decrease_are_left_out_except_lift_off() -> None:
    ranking = found().screening.ranking
    fits = {one.start.site: one.screened.decrease for one in ranking if one.strength == "gain"}
    (held,) = [one for one in ranking if one.start.effect.name == "lift_off" and one.start.is_textbook]
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
    assert any(one.preliminary_general for one in bent().candidates)
    for written, candidates in ((found(), tried()), (bent(), tried("asymmetry", "gain"))):
        again = from_checkpoint(json.loads(json.dumps(to_checkpoint(written))), candidates)
        for one, same in zip(again.candidates, written.candidates, strict=True):
            assert one.all_tried == same.all_tried and one.start == same.start
        for one, same in zip(again.screening.ranking, written.screening.ranking, strict=True):
            assert one.screened == same.screened
            assert (one.key, one.strength, one.index) == (same.key, same.strength, same.index)
        np.testing.assert_array_equal(again.screening.chance, written.screening.chance)


@pytest.mark.parametrize(
    "damage",
    [
        {"ranking": [[999, 0.0, 0.0, 0.0, 0.0, 1.0]]},
        {"ranking": [[0, 0.0, 0.0, 0.0, 1.0]]},
        {"chance": []},
        {"chance": ["x"]},
        {"ranking": []},
        {"fits": [[0, [0.0, 0.0, {"nonsense": 1.0}]]]},
        {"fits": [[0, [0.0, 0.0, {"gain": 0.05}, 1.0]]]},
        {"fits": [[0]]},
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
        next(fits)
        return itertools.chain([(None, None)], fits)

    again = preliminary_fits(
        hiding.nuisance(hiding.louder, hiding.plain), tried(), 0,
        lambda stage, share: shares.append(share) if stage == "preliminary fits" else None, SETTINGS, parallel,
    )  # fmt: skip
    assert [one.key for one in again.candidates] == [one.key for one in others]
    assert [one.tried.gain for one in again.candidates] == [one.tried.gain for one in others]
    assert shares == pytest.approx(np.arange(1, len(others) + 2) / (len(others) + 1))
