"""A search with the true law in the catalogue: it explains what the hidden effect changes, and no more."""

import dataclasses
from functools import cache
from types import SimpleNamespace

import hiding
import numpy as np
import pytest
from hiding import applied

from biodyn_core.base.errors import InputError
from biodyn_core.tracing.beside import answered, beside
from biodyn_core.tracing.candidate import Candidate, ScreeningResult
from biodyn_core.tracing.fitted_candidates import WithoutEffect, candidate_fit
from biodyn_core.tracing.local_fit import fit_locally
from biodyn_core.tracing.probability import probabilities
from biodyn_core.tracing.rounds import Search
from biodyn_core.tracing.screen import Screening
from biodyn_core.tracing.settings import TraceSettings
from blind.tracing import ceiling as ceiling_module
from blind.tracing.outcome import Cause
from blind.tracing.records import Record
from blind.tracing.true_law import with_true_law
from blind.training import traced as traced_module


@cache
def search() -> Search:
    """A cubic and a stop of the seat's joint for a body that is stiffer there in compression: both are other laws."""
    without = WithoutEffect(hiding.nuisance(law=hiding.one_sided))
    fitted = []
    for name in ("cubic", "asymmetry"):
        start = applied(name, "pelvis")
        fit = candidate_fit(without, [(1.0, fit_locally(without.nuisance, start))])
        fitted.append(Candidate(start, start.effect.strengths[0], 0, ScreeningResult(0.1, 0.1, 1.0, 0.1, 0.5), fit=fit))
    of_fits = {one.key: answered(without.nuisance, one.fitted.local.subject) for one in fitted}
    return Search(without, Screening((), np.zeros(1)), (), tuple(fitted), beside(without.nuisance, of_fits))


def ideal(cause: Cause) -> Search | None:
    return with_true_law(search(), cause, hiding.fitted(), hiding.events(6))


def test_the_true_law_gains_more_than_a_law_that_resembles_it() -> None:
    found, fitted = ideal(Cause("asymmetry", "pelvis", "")), search().fitted
    assert found is not None
    best, other = found.fitted
    assert best.key == fitted[1].key and other is fitted[0]
    assert best.fitted.gain > fitted[1].fitted.gain + 0.1
    left = best.fitted.local.residual_square.sum()
    assert left < 0.5 * fitted[1].fitted.local.residual_square.sum()
    # What rests is the noise, of which no other candidate explains a part.
    samples = found.nuisance.choose.products.samples.sum()
    assert np.sqrt(left / samples) < 1.2
    assert {(effect, site): gain for effect, site, gain in found.beside[best.key]}[other.key] < 0.02


def test_its_theta_is_that_of_the_body_without_the_effect() -> None:
    found = ideal(Cause("asymmetry", "pelvis", ""))
    assert found is not None
    subject = found.fitted[0].fitted.local.subject
    assert subject.parameters == hiding.fitted().parameters
    assert [one.effect.name for one in subject.effects] == ["asymmetry"]


@pytest.mark.parametrize(("site", "known"), [("", True), ("head", False)])
def test_a_cause_without_a_site_is_at_that_of_the_best_candidate(site: str, known: bool) -> None:
    found = ideal(Cause("asymmetry", site, ""))
    assert (found is not None) == known
    assert found is None or found.fitted[0].start.site == "pelvis"


def record(law: hiding.Law) -> Record:
    cases = hiding.events(9, law=law)
    return Record(hiding.TRUTH, cases[:3], cases[3:])


def test_the_ceiling_is_the_decision_with_the_true_law(monkeypatch: pytest.MonkeyPatch) -> None:
    """The search is given, so that the answer is that of the true law alone."""
    monkeypatch.setattr(ceiling_module, "search", lambda *_: search())
    cause, records = Cause("asymmetry", "pelvis", ""), [record(hiding.one_sided), record(hiding.plain)]
    before, without_effect = hiding.fitted(law=hiding.one_sided), hiding.fitted()
    found = ceiling_module.ceiling(records[0], before, cause, records[1], without_effect)
    evidence = search().evidence(TraceSettings(), search().diagnostics(TraceSettings()))
    without = probabilities(evidence, ceiling_module.decision_with_true_laws())
    assert found is not None
    assert found.of(("asymmetry", "pelvis")) > without.of(("asymmetry", "pelvis"))
    assert next(iter(found.of_answers)) == "nonlinear_stiffness"
    gone = dataclasses.replace(cause, name="skin")
    assert ceiling_module.ceiling(records[0], before, gone, records[1], without_effect) is None


def test_a_body_has_its_ratio_and_the_evidence_with_and_without_the_true_law(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without effects there is no ratio, without a cause of the catalogue no true law, without a fit nothing."""
    laws = {True: hiding.one_sided, False: hiding.plain}
    monkeypatch.setattr(traced_module, "record", lambda one, with_effects=True: record(laws[with_effects]))
    monkeypatch.setattr(traced_module, "searched", lambda hidden, settings: search())
    theta = hiding.TRUTH.parameters.vector()
    busy, idle = (SimpleNamespace(effects=effects, theta=theta) for effects in (("hidden",), ()))
    cause = Cause("asymmetry", "pelvis", "")
    found, outside, nothing = (traced_module.traced(*of) for of in ((busy, cause), (busy, None), (idle, None)))
    assert found is not None and outside is not None and nothing is not None
    assert found.ratio == outside.ratio and found.ratio > 1.0 and nothing.ratio is None
    assert found.evidence == outside.evidence == nothing.evidence != found.with_true_law
    assert outside.with_true_law is None and nothing.with_true_law is None

    def unfit(*_: object) -> Search:
        raise InputError("unstable")

    for other in (lambda *_: None, unfit):
        monkeypatch.setattr(traced_module, "searched", other)
        assert traced_module.traced(busy, cause) is None
