"""One round of a search: stored fits, starts, and the fit of the chosen candidate."""

import dataclasses
import json
from functools import cache
from types import SimpleNamespace

import hiding
import numpy as np
import pytest
from hiding import applied

from biodyn_core.tracing import fitted_candidates, rounds
from biodyn_core.tracing.answers import UnstableSimulation
from biodyn_core.tracing.candidate import Candidate, CandidateFit, PreliminaryFit, ScreeningResult
from biodyn_core.tracing.local_fit import LocalFit, fit_locally
from biodyn_core.tracing.preliminary_fit import PreliminaryFits
from biodyn_core.tracing.screen import Screening
from biodyn_core.tracing.settings import LocalFitSettings, PreliminarySettings, TraceSettings
from biodyn_core.tracing.unsteady import UnsteadyCause

SETTINGS = TraceSettings(refined=2, generalised=0)


@cache
def without() -> LocalFit:
    return fit_locally(hiding.nuisance(hiding.louder), None)


def candidates() -> list[Candidate]:
    """A gain and a skin, screened and fitted to few events."""
    found = []
    for index, one in enumerate((applied("gain", "neck", gain=0.05), applied("skin", "head"))):
        fit = PreliminaryFit(0.4 - 0.1 * index, 0.3, one, hiding.TRUTH.parameters)
        screening = ScreeningResult(0.3, 0.2, 1.0, 0.1, 0.01)
        found.append(Candidate(one, one.effect.strengths[0], index, screening, fit))
    return found


def screened(*ranking: Candidate) -> Screening:
    return Screening(ranking, np.array([0.01]))


def nothing(stage: str, share: float) -> None:
    """No progress is shown."""


def test_preliminary_fits_are_stored_for_their_events_and_seed(monkeypatch: pytest.MonkeyPatch) -> None:
    tried, computed = candidates(), []

    def fits(few, given, seed, *others) -> PreliminaryFits:
        computed.append(seed)
        return PreliminaryFits(screened(*given), tuple(given))

    monkeypatch.setattr(rounds, "preliminary_fits", fits)
    few, stored = hiding.nuisance(hiding.louder), {}

    def found(seed: int, checkpoint: dict | None, given: list[Candidate] = tried) -> PreliminaryFits:
        return rounds._preliminary(few, given, SETTINGS, seed, nothing, checkpoint, None)

    first, stored = found(1, stored), json.loads(json.dumps(stored))
    again = found(1, stored)
    assert computed == [1] and len(stored) == 1
    assert [one.tried for one in again.candidates] == [one.tried for one in first.candidates]
    assert [one.screened for one in again.screening.ranking] == [one.screened for one in first.screening.ranking]
    found(2, stored)
    found(1, None)
    assert computed == [1, 2, 1] and len(stored) == 2
    # A further event has another reach of the joints, hence other starts, or lacks the channels of a candidate.
    stronger = dataclasses.replace(tried[0], start=applied("gain", "neck", gain=0.06))
    for other in ([stronger, tried[1]], tried[:1]):
        found(1, stored, other)
    assert computed == [1, 2, 1, 1, 1] and len(stored) == 4


@pytest.mark.parametrize(("objective", "moved"), [(1.0, True), (np.inf, False)])
def test_a_candidate_starts_from_its_best_stable_fit_to_few_events(objective: float, moved: bool) -> None:
    """An unstable fit leaves the start of the preliminary fit; beyond the first ones all have that."""
    tried, better = candidates(), applied("gain", "neck", gain=0.12)
    settings = dataclasses.replace(SETTINGS, preliminary=PreliminarySettings(many_starts=1))
    worse = dataclasses.replace(without(), applied=applied("gain", "neck", gain=0.2), objective=np.inf)
    best = dataclasses.replace(without(), applied=better, objective=objective)
    count = 1 + len(rounds._shapes(screened(*tried), tried[0], settings.preliminary))

    def parallel(stage, function, few, starts):
        assert len(starts) == count > 2
        return iter([worse, best, *[worse] * (count - 2)])

    found = rounds._best_starts(hiding.nuisance(hiding.louder), screened(*tried), tried, settings, parallel)
    assert [start for start, _ in found] == [better if moved else tried[0].tried.applied, tried[1].tried.applied]
    assert [theta for _, theta in found] == [
        best.subject.parameters if moved else tried[0].tried.theta, tried[1].tried.theta,
    ]  # fmt: skip


def test_candidates_without_a_stable_fit_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    tried, shares = candidates(), []
    nuisance = hiding.nuisance(hiding.louder)
    starts = [(one.start, None) for one in tried]
    monkeypatch.setattr(rounds, "_best_starts", lambda *_: starts)
    local = fit_locally(nuisance, applied("skin", "head"), LocalFitSettings(steps=1))
    found = rounds._fitted(
        nuisance, PreliminaryFits(screened(*tried), tuple(tried)), rounds.WithoutEffect(nuisance), SETTINGS,
        lambda stage, share: shares.append(share),
        lambda stage, function, shared, items: iter([[], [(nuisance.prior_scale, local)]][: len(items)]),
    )  # fmt: skip
    assert [one.key for one in found] == [("skin", "head")] and shares == [0.0, 0.5, 1.0]
    assert found[0].fitted.local is local


@pytest.mark.parametrize(("name", "refits"), [("gain", False), ("clock", True)])
def test_a_cause_that_varies_with_time_keeps_its_fit_unless_it_has_a_constant_part(name: str, refits: bool) -> None:
    nuisance, one = hiding.nuisance(hiding.louder), applied(name, "neck")
    local = dataclasses.replace(without(), applied=one, residual_square=0.5 * without().residual_square)
    fit = CandidateFit(local, np.full(3, 0.4), ("road",) * 3, steady=False)
    found = rounds._with_intervals(nuisance, Candidate(one, "", fit=fit), SETTINGS)
    assert (found is not local) == refits
    assert bool(found.intervals) == refits and bool(found.subject.effects) == refits
    np.testing.assert_array_equal(found.residual_square, local.residual_square)  # of the varying cause


def test_the_better_form_is_kept_with_the_intervals_of_the_textbook_form() -> None:
    nuisance, one = hiding.nuisance(law=hiding.one_sided), applied("asymmetry", "pelvis")
    textbook = fit_locally(nuisance, one)
    general = fit_locally(nuisance, textbook.applied, textbook=False, theta=textbook.subject.parameters)
    fits = [CandidateFit(local, np.full(3, gain), ("road",) * 3) for local, gain in ((textbook, 0.2), (general, 0.3))]
    kept = [rounds._with_intervals(nuisance, Candidate(one, "", fit=fits[0], general=of), SETTINGS)
            for of in (None, fits[1])]  # fmt: skip
    assert [found.subject.effects[0].is_textbook for found in kept] == [True, False]
    assert kept[1].subject is general.subject and kept[1].residual_square is general.residual_square
    assert kept[0].intervals == kept[1].intervals and len(kept[0].intervals) == 1


def test_an_event_whose_simulation_is_unstable_is_refused_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    cases, unstable = hiding.events(6), dataclasses.replace(without(), objective=np.inf)
    monkeypatch.setattr(rounds, "_most_probable", lambda nuisance, settings: hiding.nuisance(hiding.louder))
    monkeypatch.setattr(rounds, "_preliminary", lambda *_: pytest.fail("the long stages began"))
    monkeypatch.setattr(rounds, "WithoutEffect", lambda *_: SimpleNamespace(at=lambda scale: unstable))
    with pytest.raises(UnstableSimulation, match="the simulation is unstable near the fitted parameters") as refused:
        rounds.search(hiding.TRUTH, cases[:3], cases[3:], SETTINGS, 1, nothing)
    assert all(case.name in str(refused.value) for case in cases)


# --- candidates fitted to all events ----------------------------------------------------------------------------------


def test_an_unstable_effect_has_no_fit_at_any_scale(monkeypatch: pytest.MonkeyPatch) -> None:
    """... and one that is unstable at its own scale alone has that of the model."""
    nuisance, one = hiding.nuisance(hiding.louder), applied("gain", "neck")
    stable = dataclasses.replace(without(), applied=one, objective=1.0, prior_scale=0.5 * nuisance.prior_scale)
    runaway = dataclasses.replace(stable, objective=np.inf)
    for fits, scales in (
        ([runaway], []),
        ([stable, stable], [nuisance.prior_scale, stable.prior_scale]),
        ([stable, runaway], [nuisance.prior_scale]),
    ):
        given = iter(fits)
        monkeypatch.setattr(fitted_candidates, "fit_locally", lambda *_, given=given, theta: next(given))
        found = fitted_candidates.fits_at_scales(nuisance, (one, hiding.TRUTH.parameters, SETTINGS.local_fit))
        assert [scale for scale, _ in found] == scales


def test_a_cause_that_varies_with_time_is_a_candidate_if_it_was_screened(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its gain is the mean log ratio of the squares; half of them is ln 2 in every event."""
    square = without().residual_square
    causes = [
        UnsteadyCause(applied("clock", "head"), 0.5 * square),
        UnsteadyCause(applied("gain", "neck"), 0.5 * square, "it is no cause"),
    ]
    monkeypatch.setattr(fitted_candidates, "unsteady_causes", lambda *_: iter(causes))
    (found,) = fitted_candidates.unsteady_candidates(
        hiding.nuisance(hiding.louder), without(), screened(*candidates()), SETTINGS.unsteady
    )
    assert found.key == ("gain", "neck") and found.fitted.objection == "it is no cause" and not found.fitted.steady
    np.testing.assert_allclose(found.fitted.gains, np.log(2.0), rtol=1e-9)
