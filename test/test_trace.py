"""A whole trace: from events of another integrator to a verdict and the errors of held-out events."""

import dataclasses
import json
import sys
from functools import cache
from types import SimpleNamespace
from typing import Any
from unittest import mock

import hiding
import numpy as np
import pytest
import streams
from hiding import applied
from scipy import signal

from biodyn_core.base.parallel import serial_map
from biodyn_core.body.parameters import UNFITTED, Parameters
from biodyn_core.body.subject import Subject
from biodyn_core.effects import CATALOGUE
from biodyn_core.identification.problem import Case, errors
from biodyn_core.tracing import rounds, sensor_tilt, settings, unsteady
from biodyn_core.tracing import trace as trace_module
from biodyn_core.tracing.answers import UnstableSimulation, answer
from biodyn_core.tracing.candidate import Candidate, CandidateFit, ScreeningResult
from biodyn_core.tracing.choice import choose
from biodyn_core.tracing.data_checks import FloorSettings, split_held_out
from biodyn_core.tracing.findings import RankedCandidate, Round, Trace
from biodyn_core.tracing.fitted_candidates import WithoutEffect
from biodyn_core.tracing.local_fit import LocalFit, fit_locally
from biodyn_core.tracing.nuisance_model import EventSet
from biodyn_core.tracing.probability import Probabilities
from biodyn_core.tracing.results import _floor_percent, _not_stored, _sensors
from biodyn_core.tracing.screen import Screening, all_candidates
from biodyn_core.tracing.settings import ReportSettings, TraceSettings
from biodyn_core.tracing.trace import trace
from biodyn_core.tracing.unsteady import unsteady_causes
from biodyn_core.tracing.verdict import reasons_of, verdict_of

QUICK = TraceSettings(base=hiding.QUICK_BASE)
SHORT = dataclasses.replace(
    QUICK, replicates=60, refined=2, most_effects=2, floor=FloorSettings(road_s=1.0, shocks=1, hard_shocks=1)
)
"""Floors for events of 5 s."""

PRIOR_SCALES = SHORT.local_fit.prior_scales

FEW = ("gain", "clock", "skin", "quadratic_damping", "lift_off")


def few(subject, cases):
    """Candidates of few effects."""
    return [one for one in all_candidates(subject, cases) if one.start.effect.name in FEW]


def traced(change=hiding.nothing, law=hiding.plain) -> Trace:
    """Three events for fitting, three for choosing and three held out."""
    return _traced(change, law)


SEARCHES: dict[tuple[hiding.Change, hiding.Law], list[tuple[tuple[Any, ...], rounds.Search]]] = {}
"""The searches of `traced`: what each was given, and what it found."""


@cache
def _traced(change, law) -> Trace:
    cases, done = hiding.events(9, change, law), SEARCHES.setdefault((change, law), [])

    def search(*given: Any) -> rounds.Search:
        done.append((given, rounds_search(*given)))
        return done[-1][1]

    rounds_search = rounds.search
    with mock.patch.object(rounds, "all_candidates", few), mock.patch.object(rounds, "search", search):
        return trace(cases[:3], cases[3:], hiding.TRUTH, SHORT, 1)


def searched(change=hiding.nothing, law=hiding.plain) -> rounds.Search:
    """The first search of a trace."""
    traced(change, law)
    return SEARCHES[change, law][0][1]


def held_out_events(found: Trace) -> list:
    return [event for event in found.events if event.use == "held_out"]


@pytest.mark.parametrize(
    ("change", "law", "name", "site", "truth"),
    [
        (hiding.louder, hiding.plain, "gain", "neck", {"gain": 0.1}),
        pytest.param(
            hiding.nothing,
            hiding.orifice,
            "quadratic_damping",
            "pelvis",
            {"growth_s_per_m": 4.0},
            marks=pytest.mark.slow,
        ),
    ],
)
def test_a_hidden_effect_is_named_with_site_and_size(change, law, name: str, site: str, truth: dict) -> None:
    found = traced(change, law)
    assert found.verdict == "effect" and found.lacking == ()
    (effect,) = found.effects
    assert (effect.effect.name, effect.site) == (name, site)
    for parameter, value in truth.items():
        assert effect.values[parameter] == pytest.approx(value, rel=0.05)
        (interval,) = [one for one in found.intervals[0] if one.name == parameter]
        assert interval.lower < value < interval.upper
    assert found.p_value is not None and found.p_value < 0.05
    assert any(name in line and site in line for line in found.reasons)
    forces = found.restoring_forces
    assert len(forces) == (effect.effect.place == "joint")  # a sensor has no force
    for force in forces:
        assert (force.site, [one.effect.name for one in force.effects]) == (site, [name])
        assert force.missing_after_n < 0.3 * force.missing_before_n
        profile = force.over_rate
        outside = (profile.measured_n > profile.upper_n + 5.0) | (profile.measured_n < profile.lower_n - 5.0)
        assert force.over_rate_first and np.isfinite(profile.lower_n).sum() > 8 and not outside.any()


@pytest.mark.parametrize(("change", "law"), [(hiding.louder, hiding.plain), (hiding.nothing, hiding.orifice)])
def test_the_effect_reduces_the_error_of_held_out_events(change, law) -> None:
    found = traced(change, law)
    assert len(held_out_events(found)) == 3
    for event in held_out_events(found):
        assert event.after.mean_percent < 0.6 * event.before.mean_percent


def test_errors_are_those_of_the_subjects_before_and_after() -> None:
    found, cases = traced(hiding.louder), {case.name: case for case in hiding.events(9, hiding.louder)}
    assert found.before.effects == () and len(found.after.effects) == 1
    for event in found.events:
        case = cases[event.name]
        for subject, event_errors, shown in (
            (found.before, event.before, event.before_mps2),
            (found.after, event.after, event.after_mps2),
        ):
            whole = answer(subject, case)
            assert event_errors.mean_percent == pytest.approx(errors(case, whole).mean_percent, rel=1e-9)
            np.testing.assert_array_equal(shown, np.where(case.compared, whole, np.nan))


def test_held_out_events_do_not_influence_the_result() -> None:
    """Changed ones change their own errors alone: the search is given the same as before, so it is not repeated."""
    cases, spoiled = hiding.events(9, hiding.louder), hiding.events(9, hiding.on_skin)
    same = traced(hiding.louder)
    aside = {event.name for event in held_out_events(same)}
    held_out = [spoiled[i] if cases[i].name in aside else cases[i] for i in range(3, 9)]
    searches = list(SEARCHES[hiding.louder, hiding.plain])

    def search(subject: Subject, train: list[Case], choose: list[Case], *more: Any) -> rounds.Search:
        (first, first_train, first_choose, *first_more), done = searches.pop(0)
        assert (subject, more[:2]) == (first, tuple(first_more[:2]))
        for ours, theirs in ((train, first_train), (choose, first_choose)):
            assert all(one is other for one, other in zip(ours, theirs, strict=True))
        return done

    with mock.patch.object(rounds, "search", search):
        found = trace(cases[:3], held_out, hiding.TRUTH, SHORT, 1)
    assert searches == []
    assert found.effects[0].values == same.effects[0].values and found.named_from == same.named_from
    assert [one.gain for one in found.rounds[0].ranking] == [one.gain for one in same.rounds[0].ranking]
    assert found.rounds[0].answers == same.rounds[0].answers
    np.testing.assert_array_equal(found.after.parameters.vector(), same.after.parameters.vector())
    assert (found.reasons, found.p_value) == (same.reasons, same.p_value)
    for ours, theirs in zip(held_out_events(found), held_out_events(same), strict=True):
        assert ours.after.mean_percent > 1.5 * theirs.after.mean_percent


@pytest.mark.slow
def test_a_trace_uses_the_given_settings_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """No part falls back on defaults of its own."""

    def refuse() -> None:
        raise AssertionError("a part of the trace makes its own settings")

    given, replaced = dataclasses.replace(SHORT, most_effects=1), set()
    for module in [one for name, one in sys.modules.items() if name.startswith("biodyn_core.tracing.")]:
        for name in [name for name in vars(module) if name.endswith("Settings") and module is not settings]:
            monkeypatch.setattr(module, name, refuse)
            replaced.add(name)
    monkeypatch.setattr(rounds, "all_candidates", few)
    assert {"LocalFitSettings", "JointRefitSettings", "MissingForceSettings", "DiagnosticSettings"} <= replaced
    cases = hiding.events(9, hiding.nothing, hiding.orifice)
    found = trace(cases[:3], cases[3:], hiding.TRUTH, given, 1)
    assert found.verdict == "effect" and found.restoring_forces


def test_an_effect_that_worsens_the_prediction_is_not_added() -> None:
    def worse(subject: Subject, *_: object, **__: object) -> Subject:
        return dataclasses.replace(subject, parameters=Parameters.from_vector(1.1 * hiding.TRUTH.parameters.vector()))

    cases, search = hiding.events(9, hiding.louder, hiding.plain), searched(hiding.louder)
    with (
        mock.patch.object(rounds, "search", return_value=search),
        mock.patch.object(trace_module, "jointly_refitted", worse),
        mock.patch.object(trace_module, "generalised", worse),
    ):
        found = trace(cases[:3], cases[3:], hiding.TRUTH, SHORT, 1)
    assert found.verdict == "effect" and found.added == () and found.after is found.before
    assert [(one.effect.name, one.site) for one in found.not_added] == [("gain", "neck")]
    assert [event.after.mean_percent for event in found.events] == [event.before.mean_percent for event in found.events]
    (line,) = [line for line in found.reasons if "without nuisance parameters" in line]
    assert line.startswith("gain at neck")


def test_an_effect_is_not_added_where_theta_alone_gains_as_much() -> None:
    """The parameters before are poor; refitted without the effect they predict as well as with it."""
    poor = dataclasses.replace(hiding.TRUTH, parameters=Parameters.from_vector(0.9 * hiding.TRUTH.parameters.vector()))
    cases = hiding.events(6)
    tiny = applied("gain", "neck", gain=0.001)
    fit = dataclasses.replace(without(), subject=dataclasses.replace(poor, effects=(tiny,)))
    outcome = rounds.Outcome(a_round({"gain": 0.9}), None, hiding.nuisance(), without(), fit)
    subject, refused = trace_module._with_joint_refit(
        poor, outcome, (cases[:3], cases[3:], ()), SHORT, {}, serial_map, first=True
    )
    assert subject is poor and not refused.adds_effect and "without nuisance parameters" in refused.why


def test_stored_refits_of_an_added_effect_are_not_computed_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Those with its textbook and general law and those without it."""
    chosen = dataclasses.replace(hiding.TRUTH, effects=(applied("asymmetry", "pelvis", asymmetry_per_m=5.0),))
    stored: dict[str, Any] = {}
    cases, fits = hiding.events(6, hiding.nothing, hiding.one_sided), []

    def fit(subject: Subject, *_: object) -> Subject:
        fits.append(subject)
        theta = Parameters.from_vector((1.0 + 0.001 * len(fits)) * subject.parameters.vector())
        return dataclasses.replace(subject, parameters=theta)

    monkeypatch.setattr(trace_module, "jointly_refitted", fit)
    monkeypatch.setattr(trace_module, "generalised", fit)
    local = dataclasses.replace(without(), subject=chosen)
    outcome = rounds.Outcome(a_round({"asymmetry": 0.9}), None, hiding.nuisance(), without(), local)

    def added(first: bool = True) -> Subject:
        kept = json.loads(json.dumps(stored))
        uses = cases[:3], cases[3:5], cases[5:]
        found, _ = trace_module._with_joint_refit(hiding.TRUTH, outcome, uses, SHORT, kept, serial_map, first)
        stored.update(kept)
        return found

    first, again = added(), added()
    assert len(fits) == 3 == len(stored) and first.effects == again.effects
    np.testing.assert_array_equal(first.parameters.vector(), again.parameters.vector())
    chosen = dataclasses.replace(chosen, effects=(applied("asymmetry", "pelvis", asymmetry_per_m=6.0),))
    outcome = dataclasses.replace(outcome, chosen=dataclasses.replace(local, subject=chosen))
    added()
    assert len(fits) == 5 == len(stored)  # another effect; the refit without it is the same
    stored.clear()
    added(first=False)
    assert len(fits) == 7  # a further effect: the subject without it is the end of a refit


def test_the_draws_are_found_if_only_refits_are_computed() -> None:
    assert trace_module._calibrated({"refit 1", "joint refit 2", "general refit 3"}) == "found"
    assert trace_module._calibrated({"refit 1", "preliminary 2"}) == "anew"


def wild(case: Case) -> Case:
    """The event with a seat motion at which stiffening joints are unstable."""
    return dataclasses.replace(case, name="wild_1", seat_mps2=1e5 * case.seat_mps2)


def test_an_effect_with_an_unstable_simulation_is_not_added(monkeypatch: pytest.MonkeyPatch) -> None:
    """It predicts the events for choosing well, and one of those for reporting not at all."""
    cases = hiding.events(9, hiding.louder, hiding.plain)
    good = dataclasses.replace(hiding.TRUTH, effects=(applied("gain", "neck", gain=0.1),))
    monkeypatch.setattr(trace_module, "jointly_refitted", lambda subject, *_: good if subject.effects else subject)
    monkeypatch.setattr(trace_module, "generalised", lambda subject, *_, **__: subject)
    outcome = rounds.Outcome(
        a_round({"gain": 0.9}), None, hiding.nuisance(), without(), dataclasses.replace(without(), subject=good)
    )
    uses = cases[:3], cases[3:6], cases[6:]
    added, named = trace_module._with_joint_refit(hiding.TRUTH, outcome, uses, SHORT, {}, serial_map, first=True)
    assert added is good and named.adds_effect
    uses = cases[:3], cases[3:6], [*cases[6:], wild(cases[6])]
    subject, refused = trace_module._with_joint_refit(hiding.TRUTH, outcome, uses, SHORT, {}, serial_map, first=True)
    assert subject is hiding.TRUTH and not refused.adds_effect
    assert refused.why == "with it the simulation of wild_1 is unstable"


@pytest.mark.parametrize("number", [3, 4])
def test_an_event_with_an_unstable_simulation_is_refused_before_the_search(
    number: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One event chooses, the next one is reported."""
    cases = list(hiding.events(9))
    cases[number] = wild(cases[number])
    monkeypatch.setattr(trace_module, "one_round", lambda *_: pytest.fail("the search began"))
    monkeypatch.setattr(trace_module, "refitted", lambda *_: hiding.TRUTH)
    with pytest.raises(UnstableSimulation, match=r"^wild_1: .* is unstable; the seat reads up to \d+ m/s\^2: look for"):
        trace(cases[:3], cases[3:], hiding.TRUTH, SHORT, 1)


def test_a_further_round_that_is_unstable_leaves_the_effects_so_far(monkeypatch: pytest.MonkeyPatch) -> None:
    """In the first round there is nothing to leave."""
    outcomes = [SimpleNamespace(chosen=SimpleNamespace(prior_scale=1.0), adds_effect=True, after=0.9)]

    def one_round(*_: object) -> SimpleNamespace:
        if not outcomes:
            raise UnstableSimulation("road_1: it runs away")
        return outcomes.pop()

    monkeypatch.setattr(trace_module, "one_round", one_round)
    monkeypatch.setattr(trace_module, "_with_joint_refit", lambda subject, outcome, *_, **__: (f"{subject}+", outcome))
    found, ended = trace_module._rounds("body", ([], [], []), SHORT, 7, lambda *_: None, {}, serial_map)
    assert [subject for subject, _ in found] == ["body+"]
    assert ended == "no further effect was searched for: road_1: it runs away"
    with pytest.raises(UnstableSimulation):
        trace_module._rounds("body", ([], [], []), SHORT, 7, lambda *_: None, {}, serial_map)


def test_nothing_hidden_is_no_effect() -> None:
    found = traced()
    assert found.verdict == "none" and found.effects == () and found.ambiguous_with == ()
    assert found.after == found.before
    assert found.p_value is not None and found.p_value > 0.05
    assert [event.before.mean_percent for event in found.events] == [e.after.mean_percent for e in found.events]
    assert found.diagnostics is not None and found.seed == 1


@pytest.mark.parametrize(("cutoff_hz", "masked"), [(100.0, 0.0), (100.0, 0.5), (120.0, 0.0), (50.0, 0.0)])
def test_the_floor_is_white_noise_after_the_low_pass(cutoff_hz: float, masked: float) -> None:
    """Known noise on a body that the subject describes exactly, by a filter of SciPy."""
    case = hiding.events(9)[0]
    rng, exact = np.random.default_rng(1), answer(streams.subject(), case)
    sos = signal.butter(4, cutoff_hz, fs=case.rate_hz, output="sos")
    noise = signal.sosfiltfilt(sos, 0.1 * rng.standard_normal(exact.shape), axis=0)
    compared = case.compared & (np.arange(len(noise)) % 300 >= 300 * masked)[:, None]
    measured = np.where(compared, exact + noise, 0.0)
    known = dataclasses.replace(case, measured_mps2=measured, compared=compared, energy=(measured**2).sum(axis=0),
                                cutoff_hz=cutoff_hz)  # fmt: skip
    right = 100.0 * np.mean(noise.std(axis=0) / np.sqrt(known.energy / compared.sum(axis=0)))
    found = _floor_percent([known], streams.subject(), ReportSettings())
    assert found is None if cutoff_hz < 100.0 else found == pytest.approx(right, rel=0.15)


def test_the_floor_is_the_simulated_noise() -> None:
    """0.02 m/s^2 before a low-pass at 100 of 300 Hz: 0.0115 of it remains."""
    found = traced()
    aside = [case for case in hiding.events(9) if case.name in {event.name for event in held_out_events(found)}]
    rms = [np.sqrt(case.energy / case.compared.sum(axis=0)) for case in aside]
    noise = hiding.NOISE_MPS2 * np.sqrt(100.0 / 300.0)
    assert found.floor_percent == pytest.approx(100.0 * np.mean([noise / one for one in rms]), rel=0.25)


def test_events_have_the_uses_of_dealt() -> None:
    cases, found = hiding.events(9, hiding.louder), traced(hiding.louder)
    choose, report = split_held_out(cases[3:])
    for use, expected in (("train", cases[:3]), ("choose", choose), ("held_out", report)):
        assert [event.name for event in found.events if event.use == use] == [case.name for case in expected]


def test_held_out_events_of_each_condition_alternate() -> None:
    base = hiding.events(6)[0]
    kinds = ("road", "road", "pothole", "road", "pothole", "rail", "road")
    cases = [dataclasses.replace(base, name=str(i), case=kind) for i, kind in enumerate(kinds)]
    choose, report = split_held_out(cases)
    assert [case.name for case in choose] == ["0", "2", "3", "5"]
    assert [case.name for case in report] == ["1", "4", "6"]
    assert split_held_out([]) == ([], [])


def test_untestable_effects_are_listed_and_not_ranked() -> None:
    for found in (traced(), traced(hiding.louder)):
        assert {name.split(" at ")[0] for name in found.untestable} == {"bending", "cross_axis", "pitch", "tilt"}
        tested = {one.applied.effect.name for one in found.rounds[0].ranking}
        assert not tested & {"bending", "cross_axis", "pitch", "tilt"}


def undecided(train: list[Case], held_out: list[Case], settings: TraceSettings = SHORT) -> Trace:
    found = trace(train, held_out, hiding.TRUTH, settings, 1)
    assert found.verdict == "not_decidable" and found.calibrated == "not"
    assert found.effects == () and found.rounds == () and found.p_value is None and found.named_from is None
    assert set(found.lacking) <= set(found.reasons)
    return found


def test_the_given_subject_is_in_the_result() -> None:
    """Its errors are those of its own parameters."""
    cases = hiding.events(9)
    off = dataclasses.replace(hiding.TRUTH, parameters=Parameters.from_vector(1.1 * hiding.TRUTH.parameters.vector()))
    found = trace(cases[3:6], cases[:3], off, QUICK, 1)
    assert found.verdict == "not_decidable" and found.given is off and found.refitted and not found.adds
    for event in found.events:
        (case,) = [one for one in cases if one.name == event.name]
        assert event.given is not None
        assert event.given.mean_percent == pytest.approx(errors(case, answer(off, case)).mean_percent, rel=1e-9)
        assert event.given.mean_percent > event.before.mean_percent
    nothing = trace([], [], off, QUICK, 1)
    assert nothing.given is nothing.before is nothing.after and not nothing.refitted
    unfitted = dataclasses.replace(off, parameters=UNFITTED)
    assert {event.given for event in trace(cases[3:5], [], unfitted, QUICK, 1).events} == {None}


def test_short_events_give_a_line_for_each_missing_amount() -> None:
    cases = list(hiding.events(9, hiding.louder))
    found = undecided(cases[:3], cases[3:], QUICK)
    for role in ("to fit", "held out"):
        assert any(line.startswith(role) and "s without shocks" in line for line in found.lacking)
        assert any(line.startswith(role) and "shocks of 0.8 g" in line for line in found.lacking)
    assert {event.use for event in found.events} == {"train", "choose", "held_out"}


def test_one_loading_condition_is_not_decidable() -> None:
    cases = hiding.events(9, hiding.louder)
    found = undecided([cases[2], cases[5]], list(cases[6:]))
    assert any("rail" in line and "two loading conditions" in line for line in found.lacking)


def test_an_event_for_fitting_and_held_out_is_not_decidable() -> None:
    cases = list(hiding.events(9, hiding.louder))
    found = undecided(cases[:4], cases[3:])
    assert [line for line in found.lacking if "also fitted" in line] == ["held out: road 3 is also fitted to"]


@pytest.mark.parametrize("held_out", [(), (2,)])
def test_without_held_out_events_it_is_not_decidable(held_out: tuple[int, ...]) -> None:
    cases = hiding.events(9, hiding.louder)
    found = undecided(list(cases[3:6]), [cases[i] for i in held_out])
    assert found.lacking != () and any("held out" in line for line in found.lacking)


def test_a_clipping_sensor_is_left_out_and_named() -> None:
    cases = list(hiding.events(9, hiding.louder))
    compared, measured = cases[0].compared.copy(), cases[0].measured_mps2.copy()
    compared[1500:1800, hiding.HEAD], measured[1500:1800, hiding.HEAD] = False, 0.0
    energy = (measured**2).sum(axis=0)
    cases[0] = dataclasses.replace(cases[0], compared=compared, measured_mps2=measured, energy=energy)
    found = undecided(cases[:3], cases[3:], QUICK)
    (line,) = found.left_out
    assert line.startswith("road 0: head") and "17 %" in line
    event = next(one for one in found.events if one.name == "road 0")
    assert np.isnan(event.measured_mps2[:, hiding.HEAD]).all()


@cache
def without() -> LocalFit:
    return fit_locally(hiding.nuisance(), None)


@pytest.mark.parametrize(
    ("declared", "names"),
    [
        ("known_omission", {"lift_off"}),
        ("constant_part", {"clock"}),
        ("sized_by_training", {"posture"}),
        ("seen_by_gyro", {"tilt"}),
        ("varies_as", {"clock", "periodic", "posture"}),
    ],
)
def test_effects_declare_their_exceptions(declared: str, names: set[str]) -> None:
    assert {effect.name for effect in CATALOGUE.values() if getattr(effect, declared)} == names


def test_effects_of_other_names_are_found_by_what_they_declare(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, module in (("clock", unsteady), ("tilt", sensor_tilt)):
        monkeypatch.setattr(module, "CATALOGUE", {"other": dataclasses.replace(CATALOGUE[name], name="other")})
    nuisance = hiding.nuisance(hiding.later)
    late = unsteady_causes(nuisance, fit_locally(nuisance, None), SHORT.unsteady)
    leaning = [dataclasses.replace(hiding.events(1)[0], mean_tilts={"neck": (0.1, 0.0)})]
    assert ("other", "head") in {(one.applied.effect.name, one.applied.site) for one in late}
    assert [(one.effect.name, one.site) for one in sensor_tilt.sensor_tilts(leaning, 0.025)] == [("other", "neck")]


def test_effects_of_one_mechanism_are_laws_of_the_same_variables() -> None:
    mechanisms: dict[str, set[str]] = {}
    for effect in CATALOGUE.values():
        mechanisms.setdefault(effect.mechanism, set()).add(effect.name)
    assert {name: effects for name, effects in mechanisms.items() if effects != {name}} == {
        "nonlinear_stiffness": {"asymmetry", "cubic", "stop"},
        "dry_friction": {"friction", "hysteresis"},
        "sprung_mass": {"viscera", "added_mass"},
    }


def test_a_drifting_clock_counts_by_its_delay_in_the_middle_of_an_event() -> None:
    nuisance = hiding.nuisance()
    half_ms = applied("clock", "head", delay_s=0.0003, drift=0.0004 / 5.0)
    assert nuisance.typical_multiple(half_ms) == pytest.approx(1.0)
    assert nuisance.typical_multiple(applied("clock", "head", delay_s=0.0, drift=-0.0003)) == pytest.approx(3.0)


def test_a_stop_counts_by_its_force_at_the_reach_of_the_joint() -> None:
    nuisance = hiding.nuisance()
    (bent,) = [one for one in nuisance.parameters if one.name == "asymmetry of pelvis"]
    stop = applied("stop", "pelvis", stiffness_ratio=0.3, gap_m=0.5 * bent.reach_m)
    assert nuisance.typical_multiple(stop) == pytest.approx(
        0.5 * 0.3 / 0.1
    )  # the typical bend is a tenth of k times the reach
    assert nuisance.typical_multiple(applied("stop", "pelvis", gap_m=1.1 * bent.reach_m)) == 0.0
    assert nuisance.typical_multiple(applied("relaxation", "pelvis")) == np.inf


def test_a_sensor_tilt_is_reported_and_is_no_cause() -> None:
    """6 deg on the mean, by the gyro; recordings correct it, so it does not explain the residual."""
    lean = {"neck": (float(np.sin(np.deg2rad(6.0))), 0.0)}
    cases = [dataclasses.replace(case, mean_tilts=lean) for case in hiding.events(9)]
    search = searched()  # a fit reads no mean tilt

    def leaning(events: EventSet) -> EventSet:
        return dataclasses.replace(
            events, cases=tuple(dataclasses.replace(case, mean_tilts=lean) for case in events.cases)
        )

    of = search.nuisance
    without_effect = WithoutEffect(dataclasses.replace(of, train=leaning(of.train), choose=leaning(of.choose)))
    tilted = dataclasses.replace(search, without_effect=without_effect)
    with mock.patch.object(rounds, "search", return_value=tilted):
        found = trace(cases[:3], cases[3:], hiding.TRUTH, SHORT, 1)
    assert found.verdict == "none" and found.effects == () and not found.adds
    (beside,) = found.sensors
    assert (beside.fault.effect.name, beside.fault.site, beside.source) == ("tilt", "neck", "gyro")
    assert not beside.explains and beside.gain is None  # no tilt was tried: the channels are missing
    assert traced().sensors == ()


# --- the decision, from probabilities --------------------------------------------------------------------------------


def fitted(name: str, site: str, gain: float = 0.4, steady: bool = True) -> Candidate:
    """A candidate fitted to three events."""
    fit = CandidateFit(
        dataclasses.replace(without(), applied=applied(name, site)), np.full(3, gain), ("road",) * 3, steady=steady
    )
    return dataclasses.replace(screened(name, site, gain), fit=fit)


def screened(name: str, site: str, gain: float = 0.1) -> Candidate:
    return Candidate(applied(name, site), "", 0, ScreeningResult(gain, 1.0, 1.0, 0.1, 0.005))


def decided(given: dict[tuple[str, str], float], fits: list[Candidate], rest=(), none=0.0, outside=0.0, least=0.0):
    """The choice among candidates with these probabilities; an answer of 0.1 is in the 90 % set."""
    p = Probabilities(tuple(given), np.array(list(given.values())), none, outside, 0.1)
    screening = Screening((), np.zeros(1))
    return choose(fits, rest, p, least, hiding.nuisance(), without(), screening, 0.1)


CUBIC, STOP, SKIN, FRICTION = ("cubic", "pelvis"), ("stop", "pelvis"), ("skin", "head"), ("friction", "neck")


def test_the_most_probable_candidate_of_the_most_probable_mechanism_is_chosen() -> None:
    """Two laws of one mechanism are more probable together than the most probable candidate alone."""
    fits = [fitted(*SKIN, 0.5), fitted(*CUBIC, 0.3), fitted(*STOP, 0.4)]
    choice = decided({SKIN: 0.35, CUBIC: 0.3, STOP: 0.2}, fits, none=0.15)
    assert choice.round.chosen is not None and choice.round.chosen.key == CUBIC
    assert choice.index is not None and choice.fitted[choice.index].key == CUBIC
    assert choice.round.best == "nonlinear_stiffness" and choice.round.answers["nonlinear_stiffness"] == 0.5
    assert [one.key for one in choice.round.ranking] == [SKIN, CUBIC, STOP]
    assert choice.round.likely == ("nonlinear_stiffness", "skin", "none")
    assert [one.key for one in choice.round.rivals] == [SKIN]  # the other law of the mechanism is no rival


@pytest.mark.parametrize(("none", "outside"), [(0.5, 0.0), (0.0, 0.5)])
def test_nothing_is_chosen_where_none_or_outside_is_most_probable(none: float, outside: float) -> None:
    choice = decided({SKIN: 0.4, CUBIC: 0.1}, [fitted(*SKIN), fitted(*CUBIC)], none=none, outside=outside)
    assert choice.index is None and choice.round.chosen is None and choice.round.rivals == ()


def test_a_candidate_is_reported_by_the_better_of_its_forms() -> None:
    textbook, bent = fitted(*CUBIC, 0.1), applied(*CUBIC, exponent=-1.0)
    general = dataclasses.replace(textbook.fitted, local=dataclasses.replace(without(), applied=bent), gains=np.ones(3))
    choice = decided({CUBIC: 0.9}, [dataclasses.replace(textbook, general=general)], none=0.1)
    assert choice.round.chosen is not None
    assert choice.round.chosen.applied is bent and choice.round.chosen.gain == 1.0
    worse = dataclasses.replace(general, gains=np.zeros(3))
    choice = decided({CUBIC: 0.9}, [dataclasses.replace(textbook, general=worse)], none=0.1)
    assert choice.round.chosen is not None and choice.round.chosen.gain == pytest.approx(0.1)


def test_a_further_effect_needs_a_probability() -> None:
    given, fits = {SKIN: 0.7, CUBIC: 0.1}, [fitted(*SKIN), fitted(*CUBIC)]
    assert decided(given, fits, none=0.2, least=0.7).index == 0
    assert decided(given, fits, none=0.2, least=0.71).index is None


def test_other_likely_sites_and_screened_candidates_are_rivals() -> None:
    head, neck = ("friction", "head"), FRICTION
    choice = decided(
        {neck: 0.5, head: 0.2, SKIN: 0.15, CUBIC: 0.05}, [fitted(*neck), fitted(*head)],
        rest=[screened(*SKIN), screened(*CUBIC)], none=0.1,
    )  # fmt: skip
    assert [one.key for one in choice.round.rivals] == [head, SKIN]
    assert [(one.key, one.refitted) for one in choice.round.ranking[2:]] == [(SKIN, False), (CUBIC, False)]


def test_a_site_counts_once_with_the_larger_gain_of_two_fits() -> None:
    clock = ("clock", "head")
    choice = decided({clock: 0.9, SKIN: 0.1}, [fitted(*clock, 0.3), fitted(*clock, 0.5, steady=False), fitted(*SKIN)])
    assert [one.key for one in choice.round.ranking] == [clock, SKIN]
    assert choice.round.chosen is not None and choice.round.chosen.gain == 0.5 and not choice.round.chosen.steady


def test_a_mechanism_without_a_fitted_candidate_is_not_chosen() -> None:
    choice = decided({SKIN: 0.6, CUBIC: 0.4}, [fitted(*CUBIC)], rest=[screened(*SKIN)])
    assert choice.index is None and choice.round.best == "skin"


def a_round(answers: dict[str, float], chosen: RankedCandidate | None = None, *rest: RankedCandidate) -> Round:
    ranking = ((chosen,) if chosen else ()) + rest
    return Round(ranking, answers, tuple(name for name, p in answers.items() if p >= 0.1), chosen, rest)


def row(name: str, site: str, p: float, **values) -> RankedCandidate:
    return RankedCandidate(applied(name, site), p, 0.4, True, 0.005, 0.1, 3, **values)


@pytest.mark.parametrize(
    ("answers", "verdict"),
    [
        ({"skin": 0.8, "none": 0.2}, "effect"),
        ({"skin": 0.79, "none": 0.21}, "ambiguous"),
        ({"none": 0.5, "skin": 0.4, "outside": 0.1}, "none"),
        ({"outside": 0.5, "skin": 0.4, "none": 0.1}, "unexplained"),
    ],
)
def test_the_verdict_follows_from_the_most_probable_answer(answers: dict[str, float], verdict: str) -> None:
    assert verdict_of(a_round(answers), 0.8) == verdict


def test_reasons_state_the_cause_and_its_other_sites() -> None:
    first = a_round(
        {"dry_friction": 0.7, "none": 0.2, "outside": 0.06, "skin": 0.04}, row(*FRICTION, 0.5, remarks=("f_n ends",)),
        row("friction", "head", 0.2),
    )  # fmt: skip
    assert reasons_of(first, 0.8) == (
        "most probable: dry friction; 0.8 is required to name one cause",
        "friction at neck: probability 0.50, gain 0.40 in events that its size was not fitted to",
        "other sites: friction at head 0.20",
        "friction at neck: f_n ends",
    )


@pytest.mark.parametrize(
    ("name", "steady", "where"),
    [
        ("clock", True, "in events that its size was not fitted to"),
        ("clock", False, "in events that it was fitted to"),
        ("posture", False, "in events that its size was not fitted to"),
    ],
)
def test_the_reason_names_the_events_of_the_gain(name: str, steady: bool, where: str) -> None:
    lines = reasons_of(a_round({name: 0.9, "none": 0.1}, row(name, "head", 0.9, steady=steady)), 0.8)
    assert any(line == f"{name} at head: probability 0.90, gain 0.40 {where}" for line in lines)


def test_likely_sensor_faults_are_reported_beside_a_cause() -> None:
    likely = SHORT.report.likely_fault
    clock, gain, tiny = row("clock", "head", 0.1), row("gain", "neck", 0.2), row("gain", "head", 0.9 * likely)
    first = a_round({"skin": 0.6, "gain": 0.2, "clock": 0.1}, row(*SKIN, 0.6), gain, clock, tiny)
    cause = applied(*SKIN)
    assert [one.fault for one in _sensors(first, (), [cause], likely)] == [gain.applied, clock.applied]
    tilt = applied("tilt", "neck", lean_x=0.1)
    (found,) = _sensors(a_round({"skin": 1.0}, row(*SKIN, 1.0)), [tilt], [cause], likely)
    assert (found.source, found.explains, found.gain) == ("gyro", False, None)


def test_a_tilt_is_listed_once_whether_the_subject_stores_it_or_not() -> None:
    """By the gyro it is a finding of its own; a cause that is not stored has the value of the gyro."""
    by_gyro, by_fit = applied("tilt", "neck", lean_x=0.1), applied("tilt", "neck", lean_x=0.02)
    assert _not_stored([by_gyro], [by_fit], []) == (by_gyro,)
    assert _not_stored([by_gyro], [by_fit], [by_fit]) == ()
    assert _not_stored([by_gyro], [applied("tilt", "head")], []) == ()
    (found,) = _sensors(a_round({"tilt": 1.0}, row("tilt", "neck", 1.0)), [by_gyro], [by_fit], 0.5)
    assert (found.source, found.explains) == ("gyro", True)


@pytest.mark.parametrize(
    ("after", "scale", "adds", "count"),
    [
        (0.1, PRIOR_SCALES[-1], True, 1),  # it predicts well enough, without deviations
        (0.1, PRIOR_SCALES[0], True, 3),  # ... but only with typical deviations
        (0.9, PRIOR_SCALES[-1], True, 3),
        (0.9, PRIOR_SCALES[-1], False, 1),
    ],
)
def test_rounds_end_when_one_adds_nothing_or_the_prediction_is_good(after, scale, adds, count, monkeypatch) -> None:
    """... or after the largest number; effects after the first one need the probability of a name."""
    asked, firsts, stages = [], [], []

    def one_round(subject, train, choose, s, seed, on_stage, checkpoint, parallel, least):
        asked.append((subject, seed, least))
        return SimpleNamespace(chosen=SimpleNamespace(prior_scale=scale), adds_effect=adds, after=after)

    def with_refit(subject, outcome, *_, first):
        firsts.append(first)
        return f"{subject}+", outcome

    monkeypatch.setattr(trace_module, "one_round", one_round)
    monkeypatch.setattr(trace_module, "_with_joint_refit", with_refit)
    s = dataclasses.replace(SHORT, most_effects=3, enough=0.5)
    found, ended = trace_module._rounds("body", ([], [], []), s, 7, lambda *stage: stages.append(stage), {}, serial_map)
    assert [subject for subject, _ in found] == ["body+", "body++", "body+++"][:count] and not ended
    assert asked == [("body", 7, 0.0), ("body+", 8, s.named_from), ("body++", 9, s.named_from)][:count]
    assert firsts == [True, False, False][:count] and stages == [("refitting", 0.0)] * (count if adds else 0)


def test_a_stored_theta_is_used_for_its_events_seed_and_settings(monkeypatch) -> None:
    cases, fits, stored = list(hiding.events(3)), [], {}
    theta = 1.01 * hiding.TRUTH.parameters.vector()

    def fit(train, subject, seed, *_):
        fits.append(seed)
        return SimpleNamespace(subject=dataclasses.replace(subject, parameters=Parameters.from_vector(theta)))

    monkeypatch.setattr(trace_module, "fit_joint", fit)
    other = dataclasses.replace(SHORT, joint_refit=dataclasses.replace(SHORT.joint_refit, least_decrease=1e-4))
    refitted = [
        trace_module.refitted(train, hiding.TRUTH, s, seed, stored, None)
        for train, seed, s in (
            (cases, 1, SHORT), (cases, 1, SHORT), (cases, 2, SHORT), (cases[:2], 1, SHORT), (cases, 1, other),
        )
    ]  # fmt: skip
    assert fits == [1, 2, 1, 1] and len(stored) == 4
    json.dumps(stored)
    for one in refitted:
        np.testing.assert_array_equal(one.parameters.vector(), theta)
    assert refitted[1].provenance == {}


def test_the_refit_includes_the_effects_that_the_subject_has() -> None:
    """Quadratic damping of 4 s/m, given as 1: else an added effect would be credited with its correction."""
    cases = list(hiding.events(6, law=hiding.orifice)[:3])
    given = dataclasses.replace(
        hiding.TRUTH, effects=(hiding.applied("quadratic_damping", "pelvis", growth_s_per_m=1.0),)
    )
    stored: dict[str, Any] = {}
    found = trace_module.refitted(cases, given, QUICK, 1, stored, serial_map)
    assert found.effects[0].values["growth_s_per_m"] == pytest.approx(4.0, rel=0.05)
    np.testing.assert_allclose(
        found.parameters.natural_frequency_hz, hiding.TRUTH.parameters.natural_frequency_hz, rtol=0.05
    )
    again = trace_module.refitted(cases, given, QUICK, 1, json.loads(json.dumps(stored)), serial_map)
    assert again.effects == found.effects
    np.testing.assert_array_equal(again.parameters.vector(), found.parameters.vector())
