"""Gains beside other candidates: the same by dense least squares, and what remains beside the true cause."""

from functools import cache

import hiding
import numpy as np
import pytest
from hiding import applied

from biodyn_core.tracing.answers import answers
from biodyn_core.tracing.beside import answered, beside, gains_beside
from biodyn_core.tracing.local_fit import LocalFit, fit_locally
from biodyn_core.tracing.nuisance_model import EventSet, NuisanceModel

TRIED = (("gain", "neck"), ("skin", "neck"), ("clock", "head"), ("friction", "pelvis"))


@cache
def fits() -> tuple[LocalFit, ...]:
    """Fits to a body whose neck reads 10 % too much."""
    nuisance = hiding.nuisance(hiding.louder)
    return tuple(fit_locally(nuisance, applied(*one)) for one in TRIED)


def dense(nuisance: NuisanceModel, a: LocalFit, b: LocalFit) -> float:
    """The gain of b beside a from all rows of all events, by least squares with the prior as further rows."""

    def stacked(events: EventSet) -> list[np.ndarray]:
        """Rows by window (w, r, k + 1), and the residual beside a (w, r)."""
        changed, columns = [], []
        for one in (nuisance.subject, a.subject, b.subject):
            pairs = zip(events.rows, answers(one, events.cases), strict=True)
            changed.append(np.concatenate([rows.residual(answer) for rows, answer in pairs]))
        columns = [np.concatenate(events.known), (changed[0] - changed[2])[:, :, None]]
        return [np.concatenate(columns, axis=2), changed[1]]

    x, y = stacked(nuisance.train)
    scale = np.sqrt(nuisance.weight)[:, None]
    prior = np.diag(np.sqrt(np.append(nuisance.precision, 0.0)))

    def solved(x: np.ndarray, prior: np.ndarray) -> np.ndarray:
        rows = np.concatenate([(x * scale[:, :, None]).reshape(-1, x.shape[2]), prior])
        return np.linalg.lstsq(rows, np.append((y * scale).ravel(), np.zeros(len(prior))), rcond=None)[0]

    with_b, without_b = solved(x, prior), solved(x[:, :, :-1], prior[:-1, :-1])
    x, y_choose = stacked(nuisance.choose)
    before = ((y_choose - x[:, :, :-1] @ without_b) ** 2).sum(axis=1)
    after = ((y_choose - x @ with_b) ** 2).sum(axis=1)
    counted, event = nuisance.choose.products.counted, nuisance.choose.products.event
    ratio = np.log(before / after)
    return float(np.mean([ratio[counted & (event == e)].mean() for e in np.unique(event)]))


@pytest.mark.slow
def test_gains_are_those_of_dense_least_squares() -> None:
    nuisance = hiding.nuisance(hiding.louder)
    found = gains_beside(nuisance, [answered(nuisance, one.subject) for one in fits()])
    for a, b in ((0, 1), (1, 0), (2, 3), (3, 0)):
        assert found[a, b] == pytest.approx(dense(nuisance, fits()[a], fits()[b]), abs=1e-6)
    assert (np.diag(found) == 0.0).all()


def test_nothing_remains_beside_the_cause_and_the_cause_remains_beside_the_others() -> None:
    nuisance = hiding.nuisance(hiding.louder)
    found = gains_beside(nuisance, [answered(nuisance, one.subject) for one in fits()])
    assert found[0].max() < 0.05
    assert (found[1:, 0] > 0.2).all()


def test_gains_are_listed_by_effect_and_site() -> None:
    nuisance = hiding.nuisance(hiding.louder)
    of_fits = [answered(nuisance, one.subject) for one in fits()[:2]]
    found, gains = beside(nuisance, dict(zip(TRIED, of_fits, strict=False))), gains_beside(nuisance, of_fits)
    assert found == {TRIED[0]: ((*TRIED[1], gains[0, 1]),), TRIED[1]: ((*TRIED[0], gains[1, 0]),)}
    assert beside(nuisance, {}) == {}
