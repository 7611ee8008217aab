"""A whole trace: from events of another integrator to a verdict and the errors of held-out events."""

import dataclasses
from functools import cache
from unittest import mock

import hiding
import numpy as np
import pytest
from hiding import applied

from biodyn_core.body.parameters import UNFITTED, Parameters
from biodyn_core.body.subject import Subject
from biodyn_core.effects import CATALOGUE, AppliedEffect
from biodyn_core.identification.problem import Case, errors
from biodyn_core.tracing import rounds
from biodyn_core.tracing import trace as trace_module
from biodyn_core.tracing.answers import answer
from biodyn_core.tracing.candidate import Candidate, CandidateFit, ScreeningResult
from biodyn_core.tracing.choice import chosen, ranked, required_gain
from biodyn_core.tracing.data_checks import FloorSettings, split_held_out
from biodyn_core.tracing.findings import RankedCandidate, Round, Trace
from biodyn_core.tracing.fitted_candidates import WithoutEffect, residual_ratio
from biodyn_core.tracing.local_fit import PRIOR_SCALES, LocalFit, fit_locally
from biodyn_core.tracing.nuisance_model import NuisanceModel
from biodyn_core.tracing.results import _sensors, _tilts, build_result
from biodyn_core.tracing.screen import Screening, all_candidates
from biodyn_core.tracing.settings import EvidenceSettings, TraceSettings
from biodyn_core.tracing.trace import trace
from biodyn_core.tracing.verdict import verdict_of

SHORT = TraceSettings(
    replicates=60, refined=2, most_effects=2, floor=FloorSettings(road_s=1.0, shocks=1, hard_shocks=1)
)
"""Floors for events of 5 s."""

FEW = ("gain", "clock", "skin", "quadratic_damping", "friction", "lift_off")


def few(subject, cases):
    """Candidates of few effects."""
    return [one for one in all_candidates(subject, cases) if one.start.effect.name in FEW]


def traced(change=hiding.nothing, law=hiding.plain) -> Trace:
    """Three events for fitting, three for choosing and three held out."""
    return _traced(change, law)


@cache
def _traced(change, law) -> Trace:
    cases = hiding.events(9, change, law)
    with mock.patch.object(rounds, "all_candidates", few):
        return trace(cases[:3], cases[3:], hiding.TRUTH, SHORT, 1)


def held_out_events(found: Trace) -> list:
    return [event for event in found.events if event.use == "held_out"]


@pytest.mark.parametrize(
    ("change", "law", "name", "site", "truth"),
    [
        (hiding.louder, hiding.plain, "gain", "neck", {"gain": 0.1}),
        (hiding.on_skin, hiding.plain, "skin", "head", {"softness_s": 1.0 / (2.0 * np.pi * 30.0)}),
        (hiding.nothing, hiding.orifice, "quadratic_damping", "pelvis", {"growth_s_per_m": 4.0}),
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


@pytest.mark.parametrize(
    ("change", "law"), [(hiding.louder, hiding.plain), (hiding.on_skin, hiding.plain), (hiding.nothing, hiding.orifice)]
)
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


def test_held_out_events_do_not_influence_the_result_and_a_seed_repeats_it() -> None:
    """Changed held-out events change their own errors alone."""
    cases, spoiled = hiding.events(9, hiding.louder), hiding.events(9, hiding.on_skin)
    same = traced(hiding.louder)
    aside = {event.name for event in held_out_events(same)}
    held_out = [spoiled[i] if cases[i].name in aside else cases[i] for i in range(3, 9)]
    with mock.patch.object(rounds, "all_candidates", few):
        found = trace(cases[:3], held_out, hiding.TRUTH, SHORT, 1)
    assert found.effects[0].values == same.effects[0].values and found.threshold == same.threshold
    assert [one.gain for one in found.rounds[0].ranking] == [one.gain for one in same.rounds[0].ranking]
    np.testing.assert_array_equal(found.after.parameters.vector(), same.after.parameters.vector())
    assert (found.reasons, found.p_value) == (same.reasons, same.p_value)
    for ours, theirs in zip(held_out_events(found), held_out_events(same), strict=True):
        assert ours.after.mean_percent > 1.5 * theirs.after.mean_percent


def test_an_effect_that_worsens_the_prediction_is_not_added() -> None:
    def worse(subject: Subject, cases: list[Case]) -> Subject:
        return dataclasses.replace(subject, parameters=Parameters.from_vector(1.1 * hiding.TRUTH.parameters.vector()))

    cases = hiding.events(9, hiding.louder, hiding.plain)
    with (
        mock.patch.object(rounds, "all_candidates", few),
        mock.patch.object(trace_module, "jointly_refitted", worse),
        mock.patch.object(trace_module, "generalised", worse),
    ):
        found = trace(cases[:3], cases[3:], hiding.TRUTH, SHORT, 1)
    assert found.verdict == "unexplained" and found.effects == () and found.after is found.before
    assert [event.after.mean_percent for event in found.events] == [event.before.mean_percent for event in found.events]
    (line,) = [line for line in found.reasons if line.startswith("gain at neck")]
    assert "without nuisance parameters" in line


def test_nothing_hidden_is_no_effect() -> None:
    found = traced()
    assert found.verdict == "none" and found.effects == () and found.ambiguous_with == ()
    assert found.after == found.before
    assert found.p_value is not None and found.p_value > 0.05
    assert [event.before.mean_percent for event in found.events] == [e.after.mean_percent for e in found.events]
    assert found.diagnostics is not None and found.seed == 1


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
    assert found.effects == () and found.rounds == () and found.p_value is None and found.threshold is None
    assert set(found.lacking) <= set(found.reasons)
    return found


def test_the_given_subject_is_in_the_result() -> None:
    """Its errors are those of its own parameters."""
    cases = hiding.events(9)
    off = dataclasses.replace(hiding.TRUTH, parameters=Parameters.from_vector(1.1 * hiding.TRUTH.parameters.vector()))
    found = trace(cases[3:6], cases[:3], off, TraceSettings(), 1)
    assert found.verdict == "not_decidable" and found.given is off and found.refitted and not found.adds
    for event in found.events:
        (case,) = [one for one in cases if one.name == event.name]
        assert event.given is not None
        assert event.given.mean_percent == pytest.approx(errors(case, answer(off, case)).mean_percent, rel=1e-9)
        assert event.given.mean_percent > event.before.mean_percent
    nothing = trace([], [], off, TraceSettings(), 1)
    assert nothing.given is nothing.before is nothing.after and not nothing.refitted
    unfitted = dataclasses.replace(off, parameters=UNFITTED)
    assert {event.given for event in trace(cases[3:5], [], unfitted, TraceSettings(), 1).events} == {None}


def test_short_events_give_a_line_for_each_missing_amount() -> None:
    cases = list(hiding.events(9, hiding.louder))
    found = undecided(cases[:3], cases[3:], TraceSettings())
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
    found = undecided(cases[:3], cases[3:], TraceSettings())
    (line,) = found.left_out
    assert line.startswith("road 0: head") and "17 %" in line
    event = next(one for one in found.events if one.name == "road 0")
    assert np.isnan(event.measured_mps2[:, hiding.HEAD]).all()


GOOD_FIT = EvidenceSettings().good_fit


def screened(effect: AppliedEffect, gain: float) -> Candidate:
    return Candidate(effect, "", 0, ScreeningResult(gain, 1.0, 1.0, 0.1, 0.005))


@pytest.mark.parametrize(
    ("declared", "names"),
    [("known_omission", {"lift_off"}), ("constant_part", {"clock"}), ("sized_by_training", {"posture"})],
)
def test_effects_declare_their_exceptions(declared: str, names: set[str]) -> None:
    assert {effect.name for effect in CATALOGUE.values() if getattr(effect, declared)} == names


@pytest.mark.parametrize("is_omission", [False, True])
def test_a_known_omission_needs_one_improved_event(is_omission: bool) -> None:
    """Any other effect needs three events, or two loading conditions."""
    name = "lift_off" if is_omission else "cubic"
    local = dataclasses.replace(without(), applied=applied(name, "pelvis"))
    settings = EvidenceSettings()
    one, two = (CandidateFit(local, np.array([0.1, *gains]), ("road",) * 3) for gains in ((-1.0, -1.0), (0.1, -1.0)))
    assert one.improves_enough(settings) is two.improves_enough(settings) is is_omission
    assert two.improves_enough(dataclasses.replace(settings, least_events=2))
    assert dataclasses.replace(two, conditions=("road", "rail", "rail")).improves_enough(settings)


@cache
def without() -> LocalFit:
    return fit_locally(hiding.nuisance(), None)


def always(nuisance: NuisanceModel, fit: LocalFit) -> WithoutEffect:
    """The same fit at every prior scale."""
    without_effect = WithoutEffect(nuisance)
    without_effect._fits.update(dict.fromkeys(PRIOR_SCALES, fit))
    return without_effect


def test_the_required_gain_grows_with_the_prior_scale() -> None:
    nuisance, settings = hiding.nuisance(), TraceSettings()
    least = [required_gain(always(nuisance.at_scale(scale), without()), settings) for scale in sorted(PRIOR_SCALES)]
    assert least[0] == settings.plain_gain and (np.diff(least) > 0.0).all()
    assert least[-1] == pytest.approx((1.0 + settings.departing) * settings.least_gain)


def test_the_required_gain_is_larger_after_an_added_effect() -> None:
    nuisance, settings = hiding.nuisance().at_scale(PRIOR_SCALES[-1]), TraceSettings()
    added = dataclasses.replace(
        nuisance, subject=dataclasses.replace(nuisance.subject, effects=(applied("cubic", "pelvis"),))
    )
    assert required_gain(always(nuisance, without()), settings) == settings.plain_gain
    assert required_gain(always(added, without()), settings) == pytest.approx(settings.least_gain)


def test_a_small_gain_of_an_unsteady_cause_is_typical() -> None:
    settings = TraceSettings()
    for gain, steady, expected in ((0.2, False, True), (0.3, False, False), (0.2, True, False)):
        local = dataclasses.replace(without(), applied=applied("clock", "head"), prior_scale=PRIOR_SCALES[-1])
        fit = CandidateFit(local, np.full(6, gain), ("road",) * 6, steady=steady)
        assert bool(fit.why_typical(settings)) == expected


def test_the_least_gain_is_required_for_a_large_residual() -> None:
    nuisance, settings = hiding.nuisance(), TraceSettings()
    times = 2.0 * GOOD_FIT / residual_ratio(nuisance, without())
    much = dataclasses.replace(without(), residual_square=times**2 * without().residual_square)
    assert residual_ratio(nuisance, much) == pytest.approx(2.0 * GOOD_FIT)
    assert [required_gain(always(nuisance.at_scale(scale), much), settings) for scale in PRIOR_SCALES] == [
        settings.least_gain
    ] * 5


def test_a_law_of_typical_size_is_a_cause_only_in_a_body_without_deviations() -> None:
    nuisance, settings = hiding.nuisance(), TraceSettings()
    (typical,) = [one for one in nuisance.parameters if one.name == "friction of pelvis"]
    assert typical.applied is not None
    spread_n = typical.spread * typical.applied.values["friction_n"]

    def against(spreads: float, prior_scale: float) -> tuple[str, ...]:
        effect = applied("friction", "pelvis", friction_n=spreads * spread_n)
        local = dataclasses.replace(without(), applied=effect, prior_scale=prior_scale)
        fit = CandidateFit(local, np.full(6, 0.3), ("road",) * 6, typical_multiple=nuisance.typical_multiple(effect))
        one = dataclasses.replace(screened(effect, 0.3), fit=fit)
        screening = Screening((), np.zeros(1), np.zeros((0, 0)))
        return ranked(one, nuisance, without(), screening, settings).objections

    (why,) = against(3.5, 0.32)
    assert why == "its size is 3.5 times the typical one, less than 4"
    assert against(4.5, 0.32) == against(3.5, PRIOR_SCALES[-1]) == ()
    (why,) = against(0.9, PRIOR_SCALES[-1])
    assert why == "its size is 0.9 times the typical one, less than 1"


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


def test_a_small_tilt_is_reported_only_for_a_body_without_deviations() -> None:
    settings, stop = TraceSettings(), RankedCandidate(applied("stop", "pelvis"), 0.4, True, 0.005, 0.1, 6)
    cases = [dataclasses.replace(hiding.events(6)[0], mean_tilts={"neck": (float(np.sin(np.deg2rad(2.0))), 0.0)})]
    plain = hiding.nuisance().at_scale(PRIOR_SCALES[-1])
    nothing_else = rounds.Outcome(Round((stop,), 0.5, None, ()), plain, without(), None)
    beside = dataclasses.replace(nothing_else, round=Round((stop,), 0.2, stop, ()), chosen=without())
    assert [one.site for one in _tilts(nothing_else, cases, settings)] == ["neck"]
    assert _tilts(beside, cases, settings) == ()


def test_a_sensor_tilt_is_reported_and_is_no_cause() -> None:
    """1.8 deg on the mean, by the gyro; recordings correct it, so it does not explain the residual."""
    lean = {"neck": (float(np.sin(np.deg2rad(1.8))), 0.0)}
    cases = [dataclasses.replace(case, mean_tilts=lean) for case in hiding.events(9)]
    with mock.patch.object(rounds, "all_candidates", few):
        found = trace(cases[:3], cases[3:], hiding.TRUTH, SHORT, 1)
    assert found.verdict == "none" and found.effects == () and not found.adds
    (beside,) = found.sensors
    assert (beside.fault.effect.name, beside.fault.site, beside.source) == ("tilt", "neck", "gyro")
    assert not beside.explains and beside.gain is None  # no tilt was tried: the channels are missing
    same = traced()
    assert found.reasons == same.reasons and found.threshold == same.threshold and same.sensors == ()


def test_a_sensor_tilt_beyond_the_data_sheet_is_named() -> None:
    """6 deg, where 4.01 are allowed."""
    lean = {"neck": (float(np.sin(np.deg2rad(6.0))), 0.0)}
    cases = [dataclasses.replace(case, mean_tilts=lean) for case in hiding.events(6)]
    outcome = dataclasses.replace(round_with(applied("gain", "neck", gain=0.01), 0.4), chosen=None)
    outcome = dataclasses.replace(outcome, round=dataclasses.replace(outcome.round, chosen=None))
    subject = hiding.nuisance().subject
    found = build_result(subject, subject, subject, [outcome], (cases[:3], cases[3:], ()), TraceSettings(), (), 1)
    assert found.verdict == "effect" and found.sensors == () and not found.adds
    assert [(one.effect.name, one.site) for one in found.effects] == [("tilt", "neck")]
    assert any("a mean tilt of 6.0 deg" in line for line in found.reasons)


def round_with(effect: AppliedEffect, before_ratio: float) -> rounds.Outcome:
    """A round with a chosen effect: the residual ratio before it, and a tenth of it after."""
    nuisance, ratio = hiding.nuisance(), residual_ratio(hiding.nuisance(), without())
    one = RankedCandidate(effect, 0.8, True, 0.005, 0.1, 6)
    before, after = (
        dataclasses.replace(without(), residual_square=(times / ratio) ** 2 * without().residual_square)
        for times in (before_ratio, 0.1 * before_ratio)
    )
    return rounds.Outcome(Round((one,), 0.2, one, ()), nuisance, before, after)


@pytest.mark.parametrize(
    ("effect", "left", "verdict"),
    [
        (applied("gain", "neck", gain=0.01), 0.4, "none"),  # within the data sheet, and nothing unusual to explain
        (applied("gain", "neck", gain=0.01), 1.1, "effect"),  # within, and it explains what is left
        (applied("gain", "neck", gain=0.1), 0.4, "effect"),  # beyond the data sheet
        (applied("clock", "neck", delay_s=0.0003), 0.4, "none"),
        (applied("clock", "neck", delay_s=0.0003), 1.1, "effect"),
        (applied("clock", "neck", delay_s=0.004), 0.4, "effect"),
        (applied("stop", "neck"), 0.4, "effect"),  # no sensor's fault
    ],
)
def test_a_fault_within_the_data_sheet_is_a_cause_only_if_it_explains_the_residual(
    effect: AppliedEffect, left: float, verdict: str
) -> None:
    outcome = round_with(effect, left)
    found_verdict, _ = verdict_of([outcome], None, (), TraceSettings())
    assert found_verdict == verdict
    beside = _sensors([outcome], (), verdict == "effect")
    assert [one.fault for one in beside] == ([effect] if verdict == "none" else [])


def test_a_fault_within_the_data_sheet_does_not_hide_a_cause_of_another_round() -> None:
    outcomes = [round_with(applied("gain", "neck", gain=0.01), 0.4), round_with(applied("stop", "head"), 0.2)]
    assert verdict_of(outcomes, None, (), TraceSettings())[0] == "effect"


def test_a_chosen_tilt_explains_the_residual() -> None:
    tilt = applied("tilt", "neck", lean_x=0.1)
    (found,) = _sensors([round_with(tilt, 1.1)], (tilt,), True)
    assert found.explains and found.gain == 0.8
    (found,) = _sensors([round_with(applied("stop", "head"), 1.1)], (tilt,), True)
    assert not found.explains and found.gain is None


@pytest.mark.parametrize(
    ("name", "steady", "where"),
    [
        ("clock", True, "in events that its size was not fitted to"),
        ("clock", False, "in events that it was fitted to, where up to 0.25 is typical"),
        ("posture", False, "in events that its size was not fitted to"),
    ],
)
def test_the_reason_names_the_events_of_the_gain(name: str, steady: bool, where: str) -> None:
    one = RankedCandidate(applied(name, "head"), 0.8, True, 0.005, 0.1, 6, steady=steady)
    outcome = rounds.Outcome(Round((one,), 0.2, one, ()), hiding.nuisance(), without(), without())
    found_verdict, reasons = verdict_of([outcome], None, (), dataclasses.replace(TraceSettings(), least_closed=0.0))
    assert found_verdict == "effect" and reasons[0] == f"clock at head gains 0.80 {where}; 0.20 is required".replace(
        "clock", name
    )


@pytest.mark.parametrize(("typical", "verdict"), [(True, "none"), (False, "unexplained")])
def test_a_candidate_of_typical_size_does_not_make_the_residual_unexplained(typical: bool, verdict: str) -> None:
    one = RankedCandidate(applied("friction", "pelvis"), 0.4, True, 0.005, 0.1, 6, ("a reason",), typical=typical)
    outcome = rounds.Outcome(Round((one,), 0.2, None, ()), hiding.nuisance(), without(), None)
    found_verdict, reasons = verdict_of([outcome], None, (), TraceSettings())
    assert found_verdict == verdict and reasons[-1] == "friction at pelvis gains 0.40, but a reason"
    # A sensor tilt is a cause by itself, but does not explain the residual of a refused candidate.
    with_tilt, _ = verdict_of([outcome], None, [applied("tilt", "neck", lean_x=0.1)], TraceSettings())
    assert with_tilt == ("effect" if typical else "unexplained")


def weighed(*given: tuple[str, str, float, bool], threshold: float = 0.2, helped: int = 6) -> int | None:
    """The index of the chosen one of (name, site, gain, on a bound), best first; each improves some of six events."""
    ranking, candidates = [], []
    for place, (name, site, gain, on_bound) in enumerate(given):
        effect = applied(name, site)
        scatter = np.resize([0.1, -0.1], 6) if place else np.zeros(6)  # events do not agree on which is better
        gains = np.where(np.arange(6) < helped, 6.0 / helped * gain + scatter, 0.0)
        against = (f"{effect.effect.parameters[0].name} ends on a bound",) if on_bound else ()
        ranking.append(RankedCandidate(effect, gain, True, 0.005, 0.1, helped, against))
        fit = CandidateFit(dataclasses.replace(without(), applied=effect), gains, ("road",) * 6)
        candidates.append(dataclasses.replace(screened(effect, gain), fit=fit))
    return chosen(ranking, candidates, threshold, TraceSettings())


def test_a_candidate_on_a_bound_is_chosen_only_with_an_overwhelming_gain() -> None:
    cubic, bent = ("cubic", "pelvis"), ("asymmetry", "neck")
    enough = TraceSettings().overwhelming * 0.2
    assert weighed((*cubic, 0.9 * enough, False)) == 0
    assert weighed((*cubic, 0.9 * enough, True)) is None
    assert weighed((*cubic, 1.1 * enough, True)) == 0
    # ... and not if it improves few events, or another one without objections comes near.
    assert weighed((*cubic, 1.1 * enough, True), helped=2) is None
    assert weighed((*cubic, 1.1 * enough, True), (*bent, 0.9 * enough, False)) == 1
    assert weighed((*cubic, 1.1 * enough, True), (*bent, 0.5 * enough, False)) == 0
    assert weighed((*cubic, 0.9 * enough, True), (*bent, 0.5 * enough, False)) == 1


def test_a_sensor_fault_is_chosen_before_an_equal_tissue_law_and_nothing_below_the_threshold() -> None:
    cubic, clock = ("cubic", "pelvis"), ("clock", "head")
    assert weighed((*cubic, 0.4, False), (*clock, 0.38, False)) == 1
    assert weighed((*cubic, 0.4, False), (*clock, 0.25, False)) == 0
    assert weighed((*cubic, 0.4, False), (*clock, 0.38, True)) == 0
    assert weighed((*cubic, 0.19, False), (*clock, 0.18, False)) is None
