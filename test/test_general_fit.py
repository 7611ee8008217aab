"""General fits: the general form of a law is fitted where the textbook form does not bend enough."""

import dataclasses
from functools import cache

import hiding
import numpy as np
import pytest
from hiding import TRUTH, applied

from biodyn_core.base.parallel import serial_map
from biodyn_core.effects import AppliedEffect
from biodyn_core.tracing import general_fit as module
from biodyn_core.tracing.candidate import Candidate, PreliminaryFit
from biodyn_core.tracing.fitted_candidates import WithoutEffect, candidate_fit
from biodyn_core.tracing.general_fit import general_fit, selected, with_general_fits
from biodyn_core.tracing.local_fit import fit_locally
from biodyn_core.tracing.settings import TraceSettings

SETTINGS = TraceSettings()


@cache
def without_effect() -> WithoutEffect:
    return WithoutEffect(hiding.nuisance(law=hiding.one_sided))


@cache
def candidate(name: str, site: str) -> Candidate:
    """A candidate with its textbook form fitted to a body whose seat's joint is stiffer in compression."""
    start = applied(name, site)
    local = fit_locally(without_effect().nuisance, start)
    return Candidate(start, start.effect.strengths[0], fit=candidate_fit(without_effect(), [(1.0, local)]))


def generalised(fitted: list[Candidate], settings: TraceSettings = SETTINGS) -> list[Candidate]:
    nuisance = without_effect().nuisance
    return with_general_fits(nuisance, without_effect(), fitted, settings, serial_map)


def test_the_general_form_gains_more_where_the_law_is_no_textbook_form() -> None:
    tried = [candidate("asymmetry", "pelvis"), candidate("gain", "neck")]
    bent, gain = generalised(tried)
    assert bent.general is not None and bent.general.applied.values["exponent"] < -0.5
    assert bent.general.local.objective < 0.9 * bent.fitted.local.objective
    assert bent.general.gain > bent.fitted.gain + 0.05 and bent.best_fit is bent.general
    assert bent.fitted is tried[0].fitted
    assert gain is tried[1] and gain.best_fit is gain.fitted  # it has no general form


def test_a_general_form_never_fits_worse_than_its_textbook_start() -> None:
    nuisance, one = without_effect().nuisance, candidate("cubic", "pelvis")
    found = general_fit((nuisance, nuisance), (one, SETTINGS))
    assert found.objective <= one.fitted.local.objective * (1.0 + 1e-6)


def test_the_preliminary_fit_is_one_of_the_starts() -> None:
    """The textbook form ends on the wrong side; from there the fit of the general form stays on it."""
    nuisance, right = without_effect().nuisance, candidate("asymmetry", "pelvis")
    start = applied("asymmetry", "pelvis", asymmetry_per_m=-1.0)
    wrong = fit_locally(nuisance, start, dataclasses.replace(SETTINGS.local_fit, steps=0))
    one = Candidate(start, "asymmetry_per_m", fit=candidate_fit(without_effect(), [(1.0, wrong)]))
    bent = general_fit((nuisance, nuisance), (right, SETTINGS))
    known = PreliminaryFit(0.5, 0.5, bent.applied, bent.subject.parameters)
    quick = dataclasses.replace(
        SETTINGS,
        local_fit=dataclasses.replace(SETTINGS.local_fit, steps=0),
        preliminary=dataclasses.replace(SETTINGS.preliminary, steps=0),
    )
    with_it = general_fit((nuisance, nuisance), (dataclasses.replace(one, preliminary_general=known), quick))
    without = general_fit((nuisance, nuisance), (one, quick))
    assert with_it.objective < 0.95 * without.objective


def test_an_unstable_general_form_leaves_the_textbook_form(monkeypatch: pytest.MonkeyPatch) -> None:
    one = candidate("asymmetry", "pelvis")
    unstable = dataclasses.replace(one.fitted.local, objective=np.inf)
    monkeypatch.setattr(module, "general_fit", lambda models, item: unstable)
    assert generalised([one]) == [one]


def of_gain(name: str, site: str, gain: float) -> Candidate:
    start: AppliedEffect = applied(name, site)
    fit = dataclasses.replace(candidate("asymmetry", "pelvis").fitted, gains=np.array([gain]))
    return Candidate(start, start.effect.strengths[0], fit=fit)


def test_the_best_candidates_and_the_best_of_each_mechanism_are_selected() -> None:
    fitted = [
        of_gain("gain", "neck", 0.1), of_gain("cubic", "neck", 0.5), of_gain("stop", "head", 0.4),
        of_gain("asymmetry", "head", 0.3), of_gain("friction", "neck", 0.2), of_gain("hysteresis", "neck", 0.15),
    ]  # fmt: skip
    assert selected(fitted, 0) == []
    assert selected(fitted, 1) == [1]
    assert selected(fitted, 2) == [1, 2, 4]  # cubic and stop are one mechanism; friction is the best of the second
    assert selected(fitted, 3) == [0, 1, 2, 3, 4]
    assert selected([], 3) == []
    bent = PreliminaryFit(0.6, 0.6, fitted[0].fitted.applied, TRUTH.parameters)
    assert selected([dataclasses.replace(fitted[0], preliminary_general=bent), *fitted[1:]], 1) == [0]
