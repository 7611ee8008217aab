"""Outputs of a trace: document, terminal, page and command; other files test the method."""

from __future__ import annotations

import dataclasses
import json
import math
import re
import shutil
import sys
import types
import xml.etree.ElementTree as ET
from functools import cache
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from listed import assert_listed
from pages import NASTY, Page, assert_self_contained, empty_drawings, lines, svg_text
from provenances import with_spread
from streams import simulated, subject

from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import MEASURED_SEGMENTS
from biodyn_core.body.parameters import PARAMETERS, UNFITTED, Parameters
from biodyn_core.body.subject import Subject, load_subject
from biodyn_core.body.usual_residual import PROVENANCE, UsualResidual, usual_residuals
from biodyn_core.effects import CATALOGUE, AppliedEffect
from biodyn_core.identification.problem import Case, Errors
from biodyn_core.tracing.findings import (
    ComparedEvent,
    Diagnostics,
    ForceProfile,
    FurtherRecordings,
    Interval,
    NamingPower,
    Need,
    NuisanceValue,
    RankedCandidate,
    RestoringForce,
    Round,
    SensorFinding,
    Surface,
    Trace,
    Verdict,
)
from biodyn_ros.base.files import check_directory
from biodyn_ros.commands.cli import main
from biodyn_ros.reading.events import BagEvent
from biodyn_ros.reading.provenance import MADE_BY_MODEL, Source, role_of, source_of
from biodyn_ros.reports.residuals import AFTER_COLOUR, BEFORE_COLOUR, residual_spectra, windowed
from biodyn_ros.trace import tracing
from biodyn_ros.trace.document import PROOF, refit_document, trace_document, traced_subject
from biodyn_ros.trace.drawings import REST_COLOUR, ranking
from biodyn_ros.trace.page import trace_page, worst_event
from biodyn_ros.trace.refit import Refit, refit_of
from biodyn_ros.trace.report import Report
from biodyn_ros.trace.text import text_of
from biodyn_ros.trace.tracing import TraceOptions, deal, stage_lines, trace_bags, write_traced
from biodyn_ros.trace.wording import (
    answer_rows,
    chance,
    diagnostic_lines,
    effect_name,
    headline,
    other_answers,
    parameters_of,
    probability,
    reliability,
    sensor_lines,
    tone,
)

SUBJECT = subject()
RATE_HZ = 200.0
VERDICTS = get_args(Verdict)

# --- material --------------------------------------------------------------------------------------------------------


def applied(name: str, site: str) -> AppliedEffect:
    effect = CATALOGUE[name]
    return AppliedEffect(effect, site, {p.name: p.size for p in effect.parameters})


STOP, FRICTION, DAMPING = (applied(name, "pelvis") for name in ("stop", "friction", "quadratic_damping"))


def errors(name: str, case: str, percents: list[float]) -> Errors:
    values = np.array(percents)
    return Errors(name, case, values, values / 5.0)


def event(name: str, case: str, use: Any, before: list[float], after: list[float], seed: int = 0) -> ComparedEvent:
    """Three seconds of a decaying swing per segment, the neck never compared, the first 0.2 s masked.

    The subject as it was given is twice as far off as the refitted one.
    """
    rng = np.random.default_rng(seed)
    seconds = np.arange(600) / RATE_HZ
    swing = np.exp(-2.0 * np.abs(seconds - 1.5)) * np.sin(2 * np.pi * 6.0 * seconds)
    measured = np.outer(swing, [2.0, 3.0, 4.0, 5.0, 6.0]) + 0.05 * rng.standard_normal((600, 5))
    shares = np.nan_to_num(np.array([before, after])) / 100.0
    late = np.outer(np.roll(swing, 4), [2.0, 3.0, 4.0, 5.0, 6.0])
    models = [measured + share * late + 0.02 * rng.standard_normal((600, 5)) for share in shares]
    gaps = np.zeros((600, 5), dtype=bool)
    gaps[:40] = True
    gaps[:, 3] = True
    parts = [np.where(gaps, np.nan, values) for values in (measured, *models)]
    percents = (before, after, (2.0 * np.array(before)).tolist())
    return ComparedEvent(name, case, use, RATE_HZ, *parts, *(errors(name, case, each) for each in percents))


NAN = math.nan
EVENTS = (
    event("road_1", "road", "train", [10.0, 12.0, 14.0, NAN, 20.0], [2.0, 3.0, 4.0, NAN, 3.0], 1),
    event("rail_1", "rail", "train", [20.0, 22.0, 24.0, NAN, 30.0], [3.0, 4.0, 5.0, NAN, 4.0], 2),
    event("rail_3", "rail", "choose", [15.0, 15.0, 15.0, NAN, 15.0], [5.0, 5.0, 5.0, NAN, 5.0], 3),
    event("road_2", "road", "held_out", [11.0, 13.0, 15.0, NAN, 21.0], [2.0, 2.0, 2.0, NAN, 2.0], 4),
    event("rail_2", "rail", "held_out", [21.0, 23.0, 25.0, NAN, 31.0], [4.0, 4.0, 4.0, NAN, 8.0], 5),
)


def given(subject: Subject, **provenance: Any) -> Subject:
    """As it was given: stiffening scale twice as large as refitted, its fit to three recordings with intervals."""
    theta = subject.parameters.vector().copy()
    theta[13] *= 2.0
    known = {
        "fitted": [{"bag": f"{name}.mcap", "sha256": name} for name in ("a", "b", "c")],
        "intervals": {
            "stiffening_scale": [1.9 * subject.parameters.stiffening_scale, 2.2 * subject.parameters.stiffening_scale],
            "damping_ratio[head]": [0.14, 0.16],
        },
    }
    return dataclasses.replace(subject, parameters=Parameters.from_vector(theta), provenance=known | provenance)


def moved(subject: Subject) -> Subject:
    """Pelvis' natural frequency 10 % down, head's damping 25 % down, and the stop added."""
    theta = subject.parameters.vector().copy()
    theta[0] *= 0.9
    theta[11] *= 0.75
    return dataclasses.replace(subject, parameters=Parameters.from_vector(theta), effects=(STOP,))


NEED = Need("to fit", 18.0, 2, 1)
EXPERIMENTS = {
    "ambiguous": "drive one shock at two levels",
    "not_decidable": "18 s more road, 2 more shocks of 0.8 g, one of them of 2 g, to fit",
}


def diagnostics() -> Diagnostics:
    return Diagnostics(
        amplitude_transfer={"road": (3.8, 4.1), "rail": (19.0, 9.0)},
        coherent={"seat": ("pelvis", 0.21), "seat.x": ("head", 0.04)},
        peeling={"neck": 1.2, "upper_torso": 1.4, "seat": 14.0},
        bracket=("pelvis",),
        level_slope=1.8,
        jump=("rail_1", 0.4),
        at_bound=("natural_frequency_hz[head]",),
        drift={"damping_ratio[neck]": 0.9, "natural_frequency_hz[pelvis]": 0.1},
        seat_tension=1.3,
    )


MECHANISMS = ("nonlinear_stiffness", "dry_friction", "quadratic_damping", "clock", "pitch")
PROBABILITIES = {
    "effect": ((0.9, 0.04, 0.02, 0.01, 0.002), 0.008, 0.02),
    "ambiguous": ((0.45, 0.25, 0.15, 0.02, 0.0), 0.03, 0.1),
    "none": ((0.06, 0.02, 0.01, 0.01, 0.0), 0.85, 0.05),
    "unexplained": ((0.2, 0.05, 0.02, 0.02, 0.01), 0.15, 0.55),
}
"""By verdict: the probabilities of the mechanisms, of none and of outside."""


def a_round(verdict: str = "effect", likely_from: float = 0.12) -> Round:
    """A round of five candidates of five mechanisms; the first one is chosen if the verdict names a cause."""
    of_mechanisms, none, outside = PROBABILITIES[verdict]
    assert sum(of_mechanisms) + none + outside == pytest.approx(1.0, abs=1e-12)
    stop, friction, damping, clock, pitch = of_mechanisms
    ranking = (
        RankedCandidate(STOP, stop, 0.81, True, 0.001, 0.35, 3),
        RankedCandidate(FRICTION, friction, 0.62, True, 0.01, 0.5, 2, ("improves 2 of 3 events",)),
        RankedCandidate(DAMPING, damping, 0.3, True, 0.02, 0.4, 3),
        RankedCandidate(applied("clock", "head"), clock, 0.02, False, 0.7, 0.9, 1),
        RankedCandidate(applied("pitch", "seat"), pitch, NAN, False, 1.0, 0.1, 0),
    )
    answers = dict(zip(MECHANISMS, of_mechanisms, strict=True)) | {"none": none, "outside": outside}
    ordered = dict(sorted(answers.items(), key=lambda item: -item[1]))
    likely = tuple(answer for answer, p in ordered.items() if p >= likely_from)
    names = verdict in ("effect", "ambiguous")
    rivals = tuple(one for one in ranking[1:] if one.applied.effect.mechanism in likely and names)
    return Round(ranking, ordered, likely, ranking[0] if names else None, rivals)


def found(verdict: Verdict = "effect", **changed: Any) -> Trace:
    """A whole trace of one verdict; whatever a verdict would not have is left out."""
    added = verdict in ("effect", "ambiguous")
    rounds = (a_round(verdict),) if verdict in PROBABILITIES else ()
    surface = Surface(
        "pelvis", np.array([-0.02, -0.01, 0.0]), np.array([-0.1, 0.1]),
        np.array([[-90.0, -5.0, NAN], [-80.0, -3.0, 1.0]]), 0.4,
    )  # fmt: skip
    whole = Trace(
        verdict=verdict,
        reasons=("stop at pelvis: gain 0.81", "other sites: none"),
        given=given(SUBJECT),
        before=SUBJECT,
        after=moved(SUBJECT) if added else SUBJECT,
        effects=(STOP,) if added else (),
        intervals=((Interval("gap_m", "m", 0.012, 0.0115, 0.0126),),) if added else (),
        ambiguous_with=tuple(one.applied for of in rounds for one in of.rivals),
        family="stiffening" if added else "",
        experiment=EXPERIMENTS.get(verdict, ""),
        events=EVENTS,
        rounds=rounds,
        nuisance=(NuisanceValue("gain of the head's sensor", -0.4), NuisanceValue("clock of the neck's sensor", 3.1)),
        diagnostics=diagnostics(),
        surface=surface if verdict == "unexplained" else None,
        floor_percent=0.9,
        p_value=0.001 if rounds else None,
        named_from=0.8 if rounds else None,
        power=NamingPower(0.5, 0.7) if verdict == "none" else None,
        untestable=("bending at neck",),
        left_out=("neck: not compared, its sensor was loose",),
        lacking=("to fit: 12 s without shocks, 30 are needed",) if verdict == "not_decidable" else (),
        seed=7,
        calibrated="anew",
        needs=(NEED,) if verdict == "not_decidable" else (),
    )
    return dataclasses.replace(whole, **changed)


def profile(law: bool, explained: float) -> ForceProfile:
    """Four bins of a stop, the last one empty."""
    at, force = np.array([-0.004, -0.002, 0.0, 0.002]), np.array([-80.0, -20.0, 0.0, NAN])
    of_law = force if law else np.full(4, NAN)
    return ForceProfile(
        at, np.array([3, 9, 50, 0]), force, force + 1.0, 0.1 * force, of_law, 1.2 * of_law, 0.8 * of_law, explained
    )


def restoring(*effects: AppliedEffect, site: str = "pelvis", by_rate: bool = False) -> RestoringForce:
    """The missing force of a joint, 15 N rms before and 1.5 N after, on two rates by four stretches."""
    grid = np.array([[-81.0, -21.0, 0.0, NAN], [-79.0, -19.0, NAN, NAN]])
    return RestoringForce(
        site=site, joint=all(one.effect.place == "joint" for one in effects), effects=effects, high_pass_hz=1.5,
        body_mass_kg=58.6, events=("road_2", "rail_2"), carried_n=87.0, missing_before_n=15.0, missing_after_n=1.5,
        stretch_m=np.array([-0.004, -0.002, 0.0, 0.002]), rate_mps=np.array([-0.1, 0.1]),
        samples=np.array([[1, 5, 50, 0], [2, 4, 0, 0]]), before_n=grid, after_n=0.1 * grid,
        over_stretch=profile(bool(effects), 0.9), over_rate=profile(bool(effects), 0.95 if by_rate else 0.1),
    )  # fmt: skip


def nothing() -> Trace:
    """A trace without events."""
    return found(
        "not_decidable", events=(), nuisance=(), diagnostics=None, floor_percent=None, calibrated="not", reasons=(),
        untestable=(), left_out=(),
    )  # fmt: skip


def page_of(trace: Trace, **more: Any) -> tuple[str, Page]:
    """The page of a trace, with empty drawings."""
    with empty_drawings():
        source = trace_page(Report(trace, **more))
    return source, Page(source)


@cache
def drawn(verdict: Verdict) -> tuple[str, Page]:
    """The page of a verdict, with its drawings."""
    trace = found(verdict)
    source = trace_page(Report(trace, dealt="dealt by turns"))
    return source, Page(source)


# --- document --------------------------------------------------------------------------------------------------------


def test_the_document_has_its_keys() -> None:
    document = json.loads(json.dumps(trace_document(Report(found())), allow_nan=False))
    least = {
        "verdict", "effects", "ambiguous_with", "separating_experiment", "error", "floor", "p_value", "named_from",
        "power", "rounds", "candidates", "diagnostics", "parameters_moved", "seed", "version",
    }  # fmt: skip
    assert least <= document.keys()
    assert {"name", "family", "site", "parameters", "intervals", "added"} == document["effects"][0].keys()
    assert {"name", "site", "probability", "gain", "score", "absorbed", "remarks"} <= document["candidates"][0].keys()
    assert document["effects"][0]["parameters"] == {"stiffness_ratio": 2.0, "gap_m": 0.012}
    assert document["effects"][0]["intervals"]["gap_m"] == {
        "value": 0.012, "unit": "m", "lower": 0.0115, "upper": 0.0126,
    }  # fmt: skip
    assert document["proof"] == PROOF and document["seed"] == 7 and document["calibrated"] == "anew"


def test_the_document_has_the_probability_of_every_answer() -> None:
    document = json.loads(json.dumps(trace_document(Report(found("ambiguous")))))
    (only,) = document["rounds"]
    assert list(only["probabilities"].items()) == [
        ("nonlinear_stiffness", 0.45), ("dry_friction", 0.25), ("quadratic_damping", 0.15), ("outside", 0.1),
        ("none", 0.03), ("clock", 0.02), ("pitch", 0.0),
    ]  # fmt: skip
    assert only["set_90"] == ["nonlinear_stiffness", "dry_friction", "quadratic_damping"]
    assert only["taken"] == {"name": "stop", "site": "pelvis"}
    assert [one["name"] for one in only["ambiguous_with"]] == ["friction", "quadratic_damping"]
    assert only["candidates"] == document["candidates"]
    assert [one["probability"] for one in only["candidates"]] == [0.45, 0.25, 0.15, 0.02, 0.0]
    assert [one["remarks"] for one in only["candidates"]] == [[], ["improves 2 of 3 events"], [], [], []]
    assert (document["named_from"], document["power"]) == (0.8, None)
    assert trace_document(Report(found("none")))["power"] == 0.7
    section = (Path(__file__).parent.parent / "docs" / "files.md").read_text().split("## trace.json")[1]
    answers = {effect.mechanism for effect in CATALOGUE.values()} | {"none", "outside"}
    assert {answer for answer in answers if f"`{answer}`" not in section} == set()


def test_errors_are_means_over_the_events_of_a_use() -> None:
    error = trace_document(Report(found()))["error"]
    assert error["before"]["train"] == {
        "pelvis": 15.0, "lower_torso": 17.0, "upper_torso": 19.0, "neck": None, "head": 25.0, "all": 19.0,
    }  # fmt: skip
    assert error["before"]["held_out"]["all"] == pytest.approx((15.0 + 25.0) / 2)
    assert error["after"]["held_out"] == {
        "pelvis": 3.0, "lower_torso": 3.0, "upper_torso": 3.0, "neck": None, "head": 5.0, "all": 3.5,
    }  # fmt: skip
    assert error["after"]["choose"]["all"] == 5.0
    without = trace_document(Report(nothing()))["error"]["before"]
    assert list(without) == ["train", "held_out"]
    assert set(without["held_out"]) == {*MEASURED_SEGMENTS, "all"} and set(without["held_out"].values()) == {None}


def test_scores_and_parameter_changes() -> None:
    document = trace_document(Report(found()))
    assert [each["score"] for each in document["candidates"]] == pytest.approx(
        [3.0, 2.0, -math.log10(0.02), -math.log10(0.7), 0.0]
    )
    assert document["candidates"][4]["gain"] is None
    impossible = dataclasses.replace(found().rounds[0].ranking[0], p_value=0.0)
    of_one = dataclasses.replace(a_round(), ranking=(impossible,))
    (only,) = trace_document(Report(found(rounds=(of_one,))))["candidates"]
    assert only["score"] is None
    changes = document["parameters_moved"]
    assert list(changes) == [parameter.name for parameter in PARAMETERS]
    assert changes["natural_frequency_hz[pelvis]"]["percent"] == pytest.approx(-10.0)
    assert changes["damping_ratio[head]"]["percent"] == pytest.approx(-25.0)
    assert changes["mass_scale"]["percent"] == 0.0


def test_a_parameter_that_was_zero_has_no_percent() -> None:
    theta = SUBJECT.parameters.vector().copy()
    theta[13] = 0.0
    linear = dataclasses.replace(SUBJECT, parameters=Parameters.from_vector(theta))
    assert trace_document(Report(found(before=linear)))["parameters_moved"]["stiffening_scale"]["percent"] is None


@pytest.mark.parametrize("verdict", VERDICTS)
def test_documents_have_no_nan(verdict: Verdict) -> None:
    lost = dataclasses.replace(
        diagnostics(), amplitude_transfer={"road": (NAN, math.inf)}, coherent={"seat": ("pelvis", NAN)},
        peeling={"head": NAN}, level_slope=NAN, jump=("rail_1", NAN), drift={"mass_scale": math.inf}, seat_tension=NAN,
    )  # fmt: skip
    for trace in (
        found(verdict),
        found(verdict, diagnostics=lost, floor_percent=NAN, p_value=NAN, power=NamingPower(0.5, NAN)),
    ):
        document = trace_document(Report(trace))
        json.dumps(document, allow_nan=False)
        text_of(Report(trace))
    if verdict == "unexplained":  # the one page with every drawing
        assert "nan" not in page_of(trace)[1].text.lower().split()


# --- wording ---------------------------------------------------------------------------------------------------------


def test_every_effect_has_a_name_at_each_of_its_sites() -> None:
    for effect in CATALOGUE.values():
        for site in effect.sites:
            assert effect_name(effect.name, site).startswith(effect.name.replace("_", " "))
    assert effect_name("stop", "pelvis") == "stop in the joint between seat and pelvis"
    assert effect_name("clock", "head") == "clock of the sensor on the head"
    assert effect_name("viscera", "lower_torso") == "viscera on the lower torso"
    shown = {name for effect in CATALOGUE.values() for name, _ in parameters_of(applied(effect.name, effect.sites[0]))}
    assert {"gap", "yield", "mass", "delay", "cubic", "natural frequency", "stiffness"} <= shown
    assert effect_name("pitch", "seat") == "pitch of the seat"


def test_each_verdict_has_its_own_sentences() -> None:
    traces = [found(verdict) for verdict in VERDICTS]
    assert len({headline(trace) for trace in traces}) == len(VERDICTS) == 5
    assert len({reliability(trace) for trace in traces}) == 5
    by_verdict = dict(zip(VERDICTS, map(headline, traces), strict=True))
    assert by_verdict["effect"] == (
        "Missing in the model: stop in the joint between seat and pelvis."
        " With it, the held-out error goes from 20.0 % to 3.50 %."
    )
    assert by_verdict["ambiguous"] == (
        "An effect is missing, one of these: stop or friction or quadratic damping in the joint between seat and"
        " pelvis."
    )
    assert by_verdict["none"] == "No missing effect found. Held-out error 20.0 %."
    assert by_verdict["unexplained"] == (
        "The most probable answer is an effect outside the catalogue. Held-out error 3.50 %."
    )
    assert by_verdict["not_decidable"] == (
        "These recordings have too little data for a verdict."
        " Record 18 s more road, 2 more shocks of 0.8 g, one of them of 2 g, to fit."
    )
    assert "not known" in headline(found("none", events=EVENTS[:2]))


def test_reliability_has_the_probability_of_the_verdict() -> None:
    of = {verdict: reliability(found(verdict)) for verdict in PROBABILITIES}
    place = "that of stop in the joint between seat and pelvis"
    assert of["effect"].startswith(f"The probability of the mechanism nonlinear stiffness is 0.90, {place} is 0.90. ")
    assert of["ambiguous"] == (
        f"The probability of the mechanism nonlinear stiffness is 0.45, {place} is 0.45."
        " Do not use the new subject as if the effect were known."
    )
    assert of["none"] == (
        "The probability that nothing visible is missing is 0.85. An effect of ratio 0.5 would have been named in 70 %"
        " of such recordings. A smaller effect may be present."
    )
    assert of["unexplained"].startswith("The probability of an effect outside the catalogue is 0.55. ")
    for share, shown in ((0.998, "more than 99"), (0.001, "less than 1"), (0.5, "50")):
        text = reliability(found("none", power=NamingPower(0.3, share)))
        assert f"An effect of ratio 0.3 would have been named in {shown} % of such recordings." in text
    assert "ratio" not in reliability(found("none", power=None))


def test_one_mechanism_has_several_effects_and_sites() -> None:
    """The mechanism is named from the sum, 0.9; the chosen effect at its site has only 0.6."""
    whole = a_round()
    stop = dataclasses.replace(whole.ranking[0], probability=0.6)
    above = dataclasses.replace(stop, applied=applied("stop", "lower_torso"), probability=0.3)
    of_two = dataclasses.replace(whole, ranking=(stop, above, *whole.ranking[1:]), chosen=stop, rivals=(above,))
    trace = found(rounds=(of_two,), ambiguous_with=(above.applied,))
    assert "nonlinear stiffness is 0.90, that of stop in the joint between seat and pelvis is 0.60." in (
        reliability(trace)
    )
    assert "also possible: stop in the joint between pelvis and lower torso" in text_of(Report(trace))
    assert "Also possible stop in the joint between pelvis and lower torso" in page_of(trace)[1].text


def test_probabilities_never_exclude_an_answer() -> None:
    assert [probability(p) for p in (0.0, 0.004, 0.005, 0.5, 0.994, 0.995, 1.0)] == [
        "< 0.01", "< 0.01", "0.01", "0.50", "0.99", "> 0.99", "> 0.99",
    ]  # fmt: skip
    assert probability(NAN) == "–"
    close = dataclasses.replace(a_round("ambiguous"), answers={"dry_friction": 0.7996, "none": 0.2004})
    assert "mechanism dry friction is 0.7996" in reliability(found("ambiguous", rounds=(close,)))  # 0.80 would be named
    assert "mechanism dry friction is 0.80" in reliability(found("effect", rounds=(close,)))


def test_ambiguous_states_whether_nothing_may_be_missing() -> None:
    """The 90 % set has outside and none from 0.03 on, outside alone from 0.08 on, one mechanism from 0.3 on."""
    wide, outside, narrow = (
        found("ambiguous", rounds=(of,), ambiguous_with=tuple(one.applied for one in of.rivals))
        for of in (a_round("ambiguous", least) for least in (0.03, 0.08, 0.3))
    )
    assert headline(wide) == (
        "An effect may be missing, one of these: stop or friction or quadratic damping in the joint between seat and"
        " pelvis, or an effect outside the catalogue."
    )
    assert headline(outside) == headline(wide).replace("may be missing", "is missing")
    assert headline(narrow) == "An effect is missing, most probably stop in the joint between seat and pelvis."


def test_a_mechanism_without_a_fitted_candidate_has_its_name() -> None:
    bare = dataclasses.replace(a_round(), chosen=None)
    named = {"rounds": (bare,), "effects": (), "intervals": (), "after": SUBJECT, "ambiguous_with": ()}
    assert headline(found(**named)) == (
        "Found: nonlinear stiffness. Nothing is added to the subject. Held-out error 20.0 %."
    )
    assert headline(found("ambiguous", **named)) == "An effect is missing, most probably nonlinear stiffness."
    assert "nonlinear stiffness is 0.90. " in reliability(found(**named))


def test_the_first_answers_and_the_whole_set_are_shown() -> None:
    assert answer_rows(a_round("unexplained")) == [
        ("an effect outside the catalogue", 0.55, True), ("nonlinear stiffness", 0.2, True),
        ("nothing visible is missing", 0.15, True), ("dry friction", 0.05, False), ("quadratic damping", 0.02, False),
    ]  # fmt: skip
    assert other_answers(a_round("unexplained")) == "2 further answers: 0.03 together"
    everything = a_round("unexplained", 0.01)
    assert len(answer_rows(everything)) == 7 and all(likely for *_, likely in answer_rows(everything))
    assert other_answers(everything) == ""
    assert other_answers(a_round("unexplained", 0.015)) == "1 further answer: 0.01"


def test_diagnostics_are_sentences_with_numbers() -> None:
    lines = diagnostic_lines(found().diagnostics)
    assert all(line.endswith(".") and line[0].isupper() for line in lines) and len(lines) == 8
    text = " ".join(lines)
    for expected in (
        "rail 19.0 (9.00)", "seat 21 % (pelvis)", "upper torso 1.40 %, seat 14.0 %",
        "lies in the joint below pelvis",
        "faster than the peak (slope of the relative residual 1.80",
        "changes most at rail_1; by chance such a change occurs in 40 %",
        "1.30 times the weight above it, more than the weight", "Table 1: natural frequency, head",
        "damping ratio, neck 0.900",
    ):  # fmt: skip
        assert expected in text, expected
    assert diagnostic_lines(None) == []


def test_the_terminal_has_the_verdict_first() -> None:
    text = text_of(Report(found("ambiguous"), dealt="by turns", warnings=("road: loose",)))
    lines, text = text.splitlines(), " ".join(text.split())
    assert max(map(len, lines)) <= 120
    assert lines[0].startswith("An effect is missing") and 15 <= len(lines) <= 40
    begin = next(i for i, line in enumerate(lines) if line.startswith("answer"))
    assert [line.split("  ") for line in [re.sub("  +", "  ", one.strip()) for one in lines[begin : begin + 7]]] == [
        ["answer", "probability", "in the 90 % set"],
        ["nonlinear stiffness", "0.45", "yes"],
        ["dry friction", "0.25", "yes"],
        ["quadratic damping", "0.15", "yes"],
        ["an effect outside the catalogue", "0.10"],
        ["nothing visible is missing", "0.03"],
        ["2 further answers: 0.02 together"],
    ]
    for expected in (
        "train, before 15.0 17.0 19.0 – 25.0 19.0", "held out, after",
        "added: stop in the joint between seat and pelvis [stiffening]:",
        "gap 0.0120 (0.0115 to 0.0126) m", "also possible: friction or quadratic damping in",
        "record next: drive one shock",
        "most probable of 5 candidates: stop, pelvis (probability 0.45, gain 0.810); friction, pelvis (",
        "left out: neck", "not testable without a channel: bending at neck",
        "largest changes by the refit: stiffening scale 0.434 to 0.217 (-50.0 %)",
        "largest changes by the effect: damping ratio, head 0.151 to 0.113 (-25.0 %)",
        "subject.yaml: the refitted subject with stop in the joint between seat and pelvis",
        "floor, error by sensor noise alone: 0.900 %", "bags: by turns", "warning: road: loose", PROOF,
    ):  # fmt: skip
        assert expected in text, expected
    assert text_of(Report(nothing())).splitlines()[0].startswith("These recordings have too little data")


def test_without_a_single_cause_the_gain_of_further_recordings_is_stated() -> None:
    further = (
        FurtherRecordings("the least data", 24, 9, 14),
        FurtherRecordings("twice the road", 24, 10, 15),
        FurtherRecordings("all of these", 24, 13, 18),
    )
    trace = found("ambiguous", further=further)
    line = (
        "in simulation of 24 bodies with one missing effect, 9 right causes are named from the least data, for fitting"
        " and again held out. With further recordings for both: twice the road: 10; all of these: 13"
    )
    for text in (" ".join(text_of(Report(trace)).split()), page_of(trace)[1].text):
        assert line in text and "drive one shock" in text
    document = trace_document(Report(trace))["further_recordings"]
    assert document[0] == {"recordings": "the least data", "bodies": 24, "named": 9, "best": 14}
    assert [one["named"] for one in document] == [9, 10, 13]
    assert trace_document(Report(found()))["further_recordings"] == []


def test_without_a_verdict_one_list_has_the_missing_recordings() -> None:
    """The list appears once, its parts are the reasons, and empty sections are left out."""
    undecided = found("not_decidable", reasons=("too little", *found("not_decidable").lacking))
    document = trace_document(Report(undecided))
    assert (
        document["to_record"] == [{"use": "to fit", "road_s": 18.0, "shocks": 2, "hard_shocks": 1, "how": ()}]
        and json.loads(json.dumps(document))["to_record"][0]["how"] == []
    )
    for text in (" ".join(text_of(Report(undecided)).split()), page_of(undecided)[1].text):
        assert text.count("18 s more road, 2 more shocks of 0.8 g, one of them of 2 g, to fit") == 1
        assert text.count("12 s without shocks, 30 are needed") == 1
    few = text_of(Report(found("not_decidable", events=EVENTS[:2], floor_percent=None)))
    assert "train, before" in few and "held out, before" not in few and "floor" not in few
    for text in (" ".join(text_of(Report(undecided)).split()), page_of(undecided)[1].text):
        assert "record next" not in text.lower() and "what the recordings lack" not in text.lower()


# --- page ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("verdict", VERDICTS)
def test_every_verdict_has_a_page(verdict: Verdict) -> None:
    source, page = drawn(verdict)
    trace = found(verdict)
    for expected in (
        headline(trace), reliability(trace), *MEASURED_SEGMENTS, *(each.name for each in EVENTS), PROOF,
        "Stop at pelvis: gain 0.81.", "clock of the neck's sensor +3.10", "bending at neck", "sensor was loose",
        "m/s²", "(m/s²)²/Hz", "Hz", "damping ratio, head",
    ):  # fmt: skip
        assert expected.replace("_", " ") in page.text.replace("_", " "), expected
    for drawing in re.findall(r"<svg.*?</svg>", source, flags=re.DOTALL):
        ET.fromstring(drawing)
    assert source.count("<svg") == {"unexplained": 4, "not_decidable": 2}.get(verdict, 3)
    assert ("Probabilities answer probability in the 90 % set" in page.text) is (verdict != "not_decidable")
    assert ("Ratio: rms of the change" in page.text) is (verdict == "none")
    assert ("missing force, N" in page.text) is (verdict == "unexplained")


def test_the_missing_force_is_drawn_before_and_after_with_its_law() -> None:
    source = trace_page(Report(found(restoring_forces=(restoring(STOP),))))
    page, drawing = Page(source), re.findall(r"<svg.*?</svg>", source, flags=re.DOTALL)[2]
    for expected in (
        "Missing force Stop in the joint between seat and pelvis", "2 held-out events",
        "87.0 N carried by the joint, 15.0 N missing before, 1.50 N after", "assumed body mass, 58.6 kg",
        "below 1.50 Hz",
    ):  # fmt: skip
        assert expected in page.text, expected
    assert "force, N" in svg_text(drawing) and "stretch, mm (negative is compression)" in svg_text(drawing)
    before, after, law = (
        [line.points for line in lines(drawing, colour, width)]
        for colour, width in ((BEFORE_COLOUR, 1.1), (AFTER_COLOUR, 1.1), (AFTER_COLOUR, 1.4))
    )
    assert [len(each) for each in (before, after, law)] == [1, 1, 1]
    assert len(before[0]) == 3  # the empty bin has no point
    fall = [one[0][0, 1] - one[0][2, 1] for one in (before, after, law)]  # the panels have one scale
    assert fall[0] == pytest.approx(10.0 * fall[1], rel=0.02) == pytest.approx(fall[2], rel=0.02)
    assert "no sensor" not in page.text


def test_a_missing_force_of_the_rate_on_a_segment_or_without_a_law() -> None:
    harness = applied("harness", "upper_torso")
    forces = (restoring(harness, site="upper_torso", by_rate=True), restoring(site="upper_torso"))
    source = trace_page(Report(found(restoring_forces=forces)))
    page, drawings = Page(source), re.findall(r"<svg.*?</svg>", source, flags=re.DOTALL)
    assert "velocity relative to the seat, m/s" in svg_text(drawings[2])
    assert "force of the effect" not in svg_text(drawings[3])
    assert "87.0 N needed to move the segment" in page.text
    assert "Joint between central torso and upper torso" in page.text and "so there is no law" in page.text
    assert page.text.count("The central torso has no sensor") == 1  # the joint's, not the segment's


def test_the_document_has_the_arrays_of_the_missing_force() -> None:
    (only,) = trace_document(Report(found(restoring_forces=(restoring(STOP),))))["restoring_force"]
    json.dumps(only, allow_nan=False)
    assert (only["site"], only["place"], only["effects"]) == ("pelvis", "joint", ["stop"])
    assert only["rms_n"] == {"carried": 87.0, "missing_before": 15.0, "missing_after": 1.5}
    assert only["before_n"] == [[-81.0, -21.0, 0.0, None], [-79.0, -19.0, None, None]]
    assert only["samples"] == [[1, 5, 50, 0], [2, 4, 0, 0]] and len(only["rate_mps"]) == 2
    assert only["over_stretch"]["law_n"] == [-80.0, -20.0, 0.0, None]
    assert only["over_stretch"]["law_lower_n"] == [-96.0, -24.0, 0.0, None]
    section = (Path(__file__).parent.parent / "docs" / "files.md").read_text().split("## trace.json")[1]
    assert all(f"`{key}`" in section for key in (*only, *only["rms_n"], *only["over_stretch"]))


def test_an_unsteady_effect_is_found_and_not_added() -> None:
    """A wandering line varies with time."""
    line = applied("periodic", "head")
    alone = found(effects=(line,), intervals=((),), after=SUBJECT)
    document = trace_document(Report(alone))
    assert [effect["added"] for effect in document["effects"]] == [False]
    assert headline(alone) == ("Found: periodic on the head. Nothing is added to the subject. Held-out error 20.0 %.")
    assert "found, not added: periodic on the head" in " ".join(text_of(Report(alone)).split())
    _, page = page_of(alone)
    assert "Effects found but not added" in page.text and "Added effects" not in page.text
    beside = found(effects=(line, STOP), intervals=((), found().intervals[0]))
    assert [effect["added"] for effect in trace_document(Report(beside))["effects"]] == [False, True]
    assert headline(beside) == (
        "Missing in the model: stop in the joint between seat and pelvis."
        " With it, the held-out error goes from 20.0 % to 3.50 %."
        " Also found, but not added: periodic on the head."
    )


LEAN = SensorFinding(
    AppliedEffect(CATALOGUE["tilt"], "head", {"lean_x": 0.0314108, "lean_y": 0.0}), "gyro", None, False
)
LATE = SensorFinding(AppliedEffect(CATALOGUE["clock"], "neck", {"delay_s": -6e-4, "drift": 0.0}), "fit", 0.2, False)
LOUD = SensorFinding(AppliedEffect(CATALOGUE["gain"], "neck", {"gain": 0.01}), "fit", 0.09, True)


def test_sensor_findings_are_independent_of_the_verdict() -> None:
    quiet = found("none", sensors=(LEAN, LATE))
    document = trace_document(Report(quiet))
    assert headline(quiet) == headline(found("none")) and document["effects"] == []
    lean, late = document["sensors"]
    assert (lean["name"], lean["site"], lean["told_by"], lean["gain"]) == ("tilt", "head", "gyro", None)
    assert (lean["size"], lean["unit"]) == (pytest.approx(np.deg2rad(1.8), rel=1e-4), "rad")
    assert lean["within_limit"] and not lean["explains"] and "ICM-20948" in lean["limit_source"]
    assert not late["within_limit"] and late["gain"] == 0.2
    tilted = (
        "the sensor on the head has a mean tilt of 1.80 deg in motion, by its gyro, which the recording corrects;"
        " within the limit of 4.01 deg; it does not explain the residual"
    )
    is_late = (
        "the sensor on the neck has a clock offset of 0.600 ms, by the fit; beyond the limit of 0.500 ms; it does not"
        " explain the residual (gain 0.200)"
    )
    terminal, page = " ".join(text_of(Report(quiet)).split()), page_of(quiet)[1].text
    for line in (tilted, is_late):
        assert f"sensor: {line}" in terminal and line[1:] in page
    assert "do not depend on the verdict" in page and "do not depend on the verdict" not in drawn("none")[1].text
    (loud,) = sensor_lines(found(sensors=(LOUD,)))
    assert (
        "a gain error of 1.00 %" in loud and "within the limit of 1.52 %" in loud and "it explains the residual" in loud
    )


def test_an_unsteady_candidate_has_no_p_value() -> None:
    anew = RankedCandidate(applied("clock", "head"), 0.9, 0.8, True, 0.005, 0.2, 6, steady=False)
    ranking = (anew, RankedCandidate(STOP, 0.06, 0.3, True, 0.01, 0.2, 6))
    answers = {"clock": 0.9, "nonlinear_stiffness": 0.06, "none": 0.03, "outside": 0.01}
    document = trace_document(Report(found(rounds=(Round(ranking, answers, ("clock",), anew, ()),))))
    (first, second) = document["candidates"]
    assert (first["p_value"], first["score"], first["steady"]) == (None, None, False)
    assert second["p_value"] == 0.01 and second["steady"]


def test_ambiguous_names_the_chosen_effect_and_its_rivals() -> None:
    line = applied("periodic", "head")
    text = headline(found("ambiguous", effects=(line, STOP), intervals=((), found().intervals[0])))
    assert "one of these: stop or friction or quadratic damping in the joint between seat and pelvis." in text
    assert text.endswith("Also found: periodic on the head.")


def test_random_draws_are_compared_with_the_chosen_gain_or_the_largest() -> None:
    assert "a gain of 0.810 (stop in the joint between seat and pelvis) in 0.1 % of random draws" in chance(found())
    unlike = a_round("none")
    largest = dataclasses.replace(unlike.ranking[1], gain=0.9)
    unsteady = dataclasses.replace(unlike.ranking[2], gain=2.0, steady=False)
    of = dataclasses.replace(unlike, ranking=(unlike.ranking[0], largest, unsteady, *unlike.ranking[3:]))
    assert "a gain of 0.900 (friction in" in chance(found("none", rounds=(of,)))
    assert "read from an earlier trace" in chance(found(calibrated="found"))
    assert chance(found(p_value=None)) == "" == chance(nothing())
    assert "a gain of 0.810 (stop in" in page_of(found())[1].text


def bars(svg: str, colour: str) -> list[float]:
    """The lengths of the bars of one colour in the order drawn."""
    paths = re.findall(rf'<path d="([^"]*)"[^>]*clip-path[^>]*style="fill: {colour}', svg)
    x = [[float(a) for a in re.findall(r"[ML] (-?[\d.]+) ", path)] for path in paths]
    return [max(one) - min(one) for one in x]


def test_the_ranking_draws_probabilities_and_beside_them_gains() -> None:
    drawing = str(ranking(a_round("effect", 0.03)))
    probability_of_stop, gain_of_stop = bars(drawing, AFTER_COLOUR)
    probability_of_rest = bars(drawing, REST_COLOUR)[:3]
    assert probability_of_rest == pytest.approx([probability_of_stop * p / 0.9 for p in (0.02, 0.01, 0.002)], abs=0.02)
    gains = bars(drawing, REST_COLOUR)[3:]
    assert gains == pytest.approx([gain_of_stop * gain / 0.81 for gain in (0.3, 0.02, 0.0)], abs=0.02)
    text = svg_text(drawing)
    for expected in (
        "0.90, chosen", "0.04, also possible", "| 0.02 |", "&lt; 0.01", "0.810 |", "0.0200, screened only",
        "friction in the joint between seat and pelvis", "probability |", "no unit",
    ):  # fmt: skip
        assert expected.replace("&lt;", "<") in text, expected


def test_each_further_round_has_its_probabilities() -> None:
    second = a_round("none")
    page = page_of(found(rounds=(a_round(), second)))[1].text
    first, later = page.split("Round 2, with the effects that the rounds before added:")
    assert "nonlinear stiffness 0.90 yes" in first and "nothing visible is missing 0.85" not in first
    assert "nothing visible is missing 0.85 yes nonlinear stiffness 0.06 an effect outside the catalogue 0.05" in later
    document = trace_document(Report(found(rounds=(a_round(), second))))
    assert [one["set_90"] for one in document["rounds"]] == [["nonlinear_stiffness"], ["none"]]


def test_green_needs_a_smaller_held_out_error() -> None:
    assert tone(Report(found())) == "good"
    worse = tuple(dataclasses.replace(each, before=each.after, after=each.before) for each in EVENTS)
    assert tone(Report(found(events=worse))) == "warn"


def test_the_page_has_numbers_before_and_after() -> None:
    _, page = drawn("effect")
    for expected in (
        "pelvis 15.0 2.50 15.0 5.00 16.0 3.00", "all 19.0 3.50 15.0 5.00 20.0 3.50", "natural frequency, pelvis",
        "F -= k_s max(0, -stretch - d0)", "0.0120 (0.0115 to 0.0126) m", "rail_2 rail held out 3.0 50.0 25.0 5.00",
        "Dealt by turns.", "-50.0 +0.0", "+0.0 -10.0", "+0.0 -25.0", "0.90, chosen", "screened only", "gap 0.0120",
        "Friction in the joint between seat and pelvis: improves 2 of 3 events.",
        "nonlinear stiffness 0.90 yes", "dry friction 0.04", "2 further answers: 0.01 together",
        "From a probability of 0.8 a mechanism is named",
        "The error by sensor noise alone is 0.900 %",
    ):  # fmt: skip
        assert expected in page.text, expected


def test_parameters_are_shown_as_given_refitted_and_with_the_effect() -> None:
    for verdict, adds in (("effect", True), ("not_decidable", False)):
        of = trace_document(Report(found(verdict)))["parameters_moved"]["stiffening_scale"]
        assert (of["given"], of["refitted"]) == (pytest.approx(0.434), pytest.approx(0.217))
        assert of["with_effect"] == (pytest.approx(0.217) if adds else None)
        assert of["refit_percent"] == pytest.approx(-50.0) and of["percent"] == 0.0
        assert (of["before"], of["after"]) == (of["refitted"], of["refitted"])
        assert of["given_interval"] == pytest.approx([1.9 * 0.217, 2.2 * 0.217])
        _, page = drawn(verdict)
        assert "refitted with the effect unit" in page.text
        assert ("subject.yaml: equals the given subject" in page.text) is not adds
        assert ("effect, %" in page.text) is adds
    unfitted = dataclasses.replace(SUBJECT, parameters=UNFITTED)
    of = trace_document(Report(found("none", given=unfitted)))["parameters_moved"]["stiffening_scale"]
    assert of["given"] is None and of["refit_percent"] is None and of["refitted"] == pytest.approx(0.217)


def refit(subject: Subject, *hashes: str) -> Refit:
    made = refit_of(found("not_decidable", given=subject), [Source(each) for each in hashes])
    assert made is not None
    return made


def refit_as_json(subject: Subject, *hashes: str) -> dict[str, Any]:
    return refit_document(refit(subject, *hashes))


def test_a_refit_outside_the_given_intervals_has_its_reason() -> None:
    """Head's damping, 0.151, stays in 0.14 to 0.16."""
    document = refit_as_json(given(SUBJECT), "a", "b", "x", "y", "z", "z")
    assert document["outside_intervals"] == ["stiffening_scale"] and document["recordings"] == 5
    assert (document["given_recordings"], document["shared_recordings"]) == (3, 2)
    assert document["error_percent"] == {"given": pytest.approx(38.0), "refitted": pytest.approx(19.0)}
    assert document["text"] == (
        "refitted to the 5 recordings given here, stiffening scale goes from 0.434 (0.412 to 0.477) to 0.217, outside"
        " its 95 % interval: these intervals hold only for the 3 recordings of that fit, of which 2 are used here;"
        " there the error is 38.0 % of the measured rms with the given parameters, 19.0 % with the refitted ones"
    )
    trace = found("not_decidable", given=given(SUBJECT))
    whole = Report(trace, refit=refit_of(trace, [Source(each) for each in "abxyzz"]))
    assert document["text"] in " ".join(text_of(whole).split())
    with empty_drawings():
        page = Page(trace_page(whole)).text
    assert document["text"][1:] in page and "outside, 0.217" in page


def test_the_largest_change_outside_its_interval_is_named() -> None:
    """Head's damping by 5 %, many half-widths of a narrow interval; stiffening by 50 %."""
    head = SUBJECT.parameters.damping_ratio[5]
    narrow = {"damping_ratio[head]": [1.01 * head, 1.011 * head], "stiffening_scale": [0.412, 0.477]}
    document = refit_as_json(given(SUBJECT, intervals=narrow), "a")
    assert document["outside_intervals"] == ["damping_ratio[head]", "stiffening_scale"]
    assert "stiffening scale goes from" in document["text"] and ", and 1 more leaves its own:" in document["text"]


def test_missing_facts_of_the_given_fit_are_named() -> None:
    assert "every parameter stays in" in refit(given(SUBJECT, intervals={"damping_ratio[head]": [0.14, 0.16]})).text
    assert "no intervals to compare with" in refit(given(SUBJECT, intervals={})).text
    assert "its file does not name" in refit(given(SUBJECT, fitted=[])).text
    assert "of which none is used here" in refit(given(SUBJECT), "x").text
    assert "was not fitted" in refit(dataclasses.replace(SUBJECT, parameters=UNFITTED), "x").text
    same = found("not_decidable", given=SUBJECT)
    assert refit_of(same, ()) is None


def test_the_page_is_self_contained_and_repeats() -> None:
    source, _ = drawn("unexplained")
    assert_self_contained(source)
    assert drawn.__wrapped__("unexplained")[0] == source


def test_names_from_outside_are_escaped() -> None:
    hostile = [dataclasses.replace(each, name=NASTY, case="<b>x</b>") for each in EVENTS]
    jumped = dataclasses.replace(diagnostics(), jump=(NASTY, 0.01))
    _, page = page_of(
        found(events=tuple(hostile), diagnostics=jumped, left_out=(NASTY,), nuisance=(NuisanceValue(NASTY, 1.0),)),
        warnings=(NASTY,), dealt=NASTY,
    )  # fmt: skip
    assert page.text.count("<script>") >= 5 and "<b>x</b>" in page.text
    assert not {"script", "img"} & set(page.tags)


def test_a_trace_without_events_has_a_page() -> None:
    source, _ = page_of(nothing())
    assert "<svg" not in source
    assert re.findall(r"<h2>(.*?)</h2>", source) == ["Parameters of the body"]


def test_the_worst_event_held_out_is_drawn() -> None:
    assert worst_event(found()).name == "rail_2"
    assert worst_event(found(events=EVENTS[:3])).name == "rail_3"
    assert worst_event(found(events=EVENTS[:2])).name == "rail_1"
    assert worst_event(nothing()) is None


def test_spectra_and_windows_have_the_power_they_should() -> None:
    seconds = np.arange(2000) / RATE_HZ
    line = np.tile(np.sin(2 * np.pi * 10.0 * seconds)[:, None], (1, 5))
    none = errors("line", "road", [50.0] * 5)
    one = ComparedEvent("line", "road", "held_out", RATE_HZ, 2.0 * line, 3.0 * line, 2.5 * line, none, none)
    frequency, density = residual_spectra([one])
    power = density.sum(axis=1) * (frequency[1] - frequency[0])
    assert power == pytest.approx(np.array([[2.0] * 5, [0.5] * 5, [0.125] * 5]), rel=0.01)
    assert frequency[density[0, :, 0].argmax()] == pytest.approx(10.0)
    middles, before, after = windowed(one)
    assert middles[:2] == pytest.approx([0.125, 0.375])
    assert np.mean(before) == pytest.approx(50.0, rel=0.02) and np.mean(after) == pytest.approx(25.0, rel=0.02)
    short = dataclasses.replace(one, **{f"{name}_mps2": line[:50] for name in ("measured", "before", "after")})
    assert residual_spectra([short]) is None and residual_spectra([]) is None


# --- bags and command ------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Two repetitions of a rail and one road."""
    return simulated(tmp_path_factory.mktemp("bags"), 4.0, {"rail_1": "rail", "rail_2": "rail", "road": "road"})


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """A trace that always finds the stop, and its arguments."""
    given: dict[str, Any] = {}

    def trace(
        train: Any, held_out: Any, subject: Any, settings: Any, seed: int, on_stage: Any, checkpoint: Any, parallel: Any
    ) -> Trace:
        given.update(train=train, held_out=held_out, subject=subject, settings=settings, seed=seed)
        on_stage("screening", 0.0)
        on_stage("screening", 1.0)
        on_stage("refitting", 0.5)
        named = [
            dataclasses.replace(EVENTS[{"train": 0, "choose": 2, "held_out": 3}[use]], name=case.name, case=case.case)
            for use, cases in (("train", train), ("choose", held_out[:-1]), ("held_out", held_out[-1:]))
            for case in cases
        ]
        return found(given.get("verdict", "effect"), events=tuple(named), seed=seed, given=subject)

    module = types.ModuleType("biodyn_core.tracing.trace")
    module.trace = trace  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "biodyn_core.tracing.trace", module)
    return given


def test_every_second_bag_of_a_condition_is_held_out() -> None:
    def held_out(**cases: str) -> list[str]:
        events = [
            (BagEvent(bag, Source(bag), types.SimpleNamespace(), False), types.SimpleNamespace(case=case))  # type: ignore[arg-type]
            for bag, case in cases.items()
        ]
        given = [event.bag for event, _ in events]
        dealt = [event for event, _ in deal(events)]
        assert sorted(event.bag for event in dealt) == sorted(given)
        assert [event.bag for event in dealt] == sorted(given, key=lambda bag: (bag in out(dealt), given.index(bag)))
        return out(dealt)

    def out(events: list[BagEvent]) -> list[str]:
        return [event.bag for event in events if event.held_out]

    bags = {"rail_1": "rail", "road_1": "road", "rail_2": "rail", "rail_3": "rail", "own": "own"}
    assert held_out(**bags) == ["rail_2"]
    assert held_out(**bags | {"own": "road"}) == ["rail_2", "own"]


def test_bags_become_cases_with_channels_and_their_roles(bags: dict[str, Path], calls: dict[str, Any]) -> None:
    traced = trace_bags(list(bags.values()), SUBJECT, TraceOptions(seed=3))
    assert [case.case for case in calls["train"]] == ["rail", "road"]
    assert [case.name for case in calls["held_out"]] == [str(bags["rail_2"])]
    assert "seat.x" in calls["train"][0].channels and calls["seed"] == 3
    document = trace_document(traced)
    assert [(Path(of["bag"]).name, of["use"]) for of in document["bags"]] == [
        ("rail_1.mcap", "train"), ("road.mcap", "train"), ("rail_2.mcap", "held_out"),
    ]  # fmt: skip
    assert "held out rail_2.mcap" in document["dealt"] and document["seconds"] > 0.0
    assert [line for line in document["warnings"] if "made by the model" in line] == [
        f"3 of 3 recordings: {MADE_BY_MODEL}"
    ]
    none, unexplained = (dataclasses.replace(traced.trace, verdict=verdict) for verdict in ("none", "unexplained"))
    assert tone(dataclasses.replace(traced, trace=none)) == "none"  # no green for recordings of the model itself
    assert tone(Report(none)) == "good"
    assert tone(dataclasses.replace(traced, trace=unexplained)) == "bad"
    assert_listed("trace.json", document)
    alone = trace_bags([bags["road"]], SUBJECT)
    assert "nothing is held out" in (alone.dealt or "") and calls["held_out"] == []
    named = trace_bags([bags["rail_1"]], SUBJECT, TraceOptions(held_out=(str(bags["road"]),)))
    assert named.dealt is None and len(calls["held_out"]) == 1


def test_written_files_are_complete_and_have_the_bags(
    bags: dict[str, Path], calls: dict[str, Any], tmp_path: Path
) -> None:
    traced = trace_bags(list(bags.values()), SUBJECT)
    out = tmp_path / "new" / "out"
    write_traced(traced, out)
    assert sorted(path.name for path in out.iterdir()) == ["subject.yaml", "trace.html", "trace.json"]
    assert json.loads((out / "trace.json").read_text()) == json.loads(json.dumps(trace_document(traced)))
    written = load_subject(out / "subject.yaml")
    assert written.effects[0].effect.name == "stop" and written.provenance["made_by"] == "biodyn trace"
    assert role_of(written, source_of(bags["rail_1"])) == role_of(written, source_of(bags["road"])) == "fitted"
    assert role_of(written, source_of(bags["rail_2"])) == "held_out"
    assert written.provenance["fitted"][0]["nrmse_rms_percent"] == 3.0
    assert written.provenance["error"]["before"] == {"train": 14.0, "held_out": 15.0}
    assert written.provenance["effects"] == {"stop at pelvis": {"gap_m": [0.0115, 0.0126]}}
    # These bags are not new for a further trace, and the origin of the first effect stays in the file.
    again = trace_bags([bags["rail_2"]], written, TraceOptions(held_out=(str(bags["road"]),)))
    assert any("had been fitted to it" in line for line in again.warnings)
    assert role_of(traced_subject(again), source_of(bags["rail_1"])) == "fitted"


def test_a_traced_subject_has_the_usual_residual_of_the_reported_events(
    bags: dict[str, Path], calls: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of those that neither fitted nor chose; these bags are too short for a law of their own."""
    laws, _ = usual_residuals(with_spread(SUBJECT).provenance)
    seen = []

    def of_events(subject: Subject, cases: list[Case]) -> dict[str, UsualResidual]:
        seen.append((subject.effects, [case.case for case in cases]))
        return laws

    traced = trace_bags(list(bags.values()), SUBJECT)
    assert PROVENANCE not in traced_subject(traced).provenance
    monkeypatch.setattr("biodyn_ros.trace.document.usual_residual", of_events)
    assert usual_residuals(traced_subject(traced).provenance) == (laws, "")
    assert seen == [(traced.trace.after.effects, ["rail"])]


@pytest.mark.parametrize("verdict", ["none", "unexplained", "not_decidable"])
def test_without_an_added_effect_the_subject_is_the_given_one(
    verdict: str, bags: dict[str, Path], calls: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Byte by byte, in place of the file of an earlier trace; a file without parameters gets none."""
    fitted = "# Anna\n" + dataclasses.replace(SUBJECT, provenance={"made_by": "biodyn fit"}).to_yaml()
    unfitted = "schema: 1\nname: anna\nbody_mass_kg: 60\nstature_m: 1.7\nmass_matrix: segment\n"
    out, anna = tmp_path / "out", tmp_path / "anna.yaml"
    command = ["trace", *map(str, bags.values()), "--subject", str(anna), "-o", str(out), "--no-report"]
    for text in (fitted, unfitted):
        anna.write_text(text, encoding="utf-8")
        calls.pop("verdict", None)
        assert main(command) == 0
        assert load_subject(out / "subject.yaml").effects[0].effect.name == "stop"
        calls["verdict"] = verdict
        capsys.readouterr()
        assert main(command) == 0
        assert (out / "subject.yaml").read_text(encoding="utf-8") == text
        assert json.loads((out / "trace.json").read_text())["subject_written"] == "as_given"
        assert "subject.yaml: equals the given subject" in capsys.readouterr().out
    traced = trace_bags(list(bags.values()), SUBJECT)
    assert traced_subject(traced) is SUBJECT


def test_the_subject_is_written_before_the_verdict(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An interruption between both files leaves the old verdict or the new subject, never the other way round."""
    monkeypatch.setattr(tracing, "write_json", lambda path, document: {}["interrupted"])
    (tmp_path / "subject.yaml").write_text("of the trace before")
    with pytest.raises(KeyError, match="interrupted"):
        write_traced(Report(found("none")), tmp_path)
    assert load_subject(tmp_path / "subject.yaml").name == SUBJECT.name


def test_the_use_of_each_bag_is_printed_before_the_computation(
    bags: dict[str, Path], calls: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    begun: list[str] = []
    method = sys.modules["biodyn_core.tracing.trace"].trace

    def trace(*given: Any, **options: Any) -> Trace:
        begun.append(capsys.readouterr().err)
        return method(*given, **options)

    monkeypatch.setattr(sys.modules["biodyn_core.tracing.trace"], "trace", trace)
    command = [
        "trace",
        "--subject",
        "subject_1",
        "--executor",
        "none",
        "-o",
        str(tmp_path / "out"),
        "--no-report",
        "--json",
    ]
    assert main([*command, *map(str, bags.values())]) == 0
    assert main([*command, str(bags["road"]), "--hold-out", str(bags["rail_2"]), str(bags["rail_1"])]) == 0
    by_default, by_name = begun
    assert by_default.splitlines() == [
        f"parameters are fitted to: {bags['rail_1']}, {bags['road']}",
        f"held out (by default, every second bag of a condition), the effect is chosen by: {bags['rail_2']}",
        "held out, errors are reported of: none",
    ]
    assert by_name.splitlines() == [
        f"parameters are fitted to: {bags['road']}",
        f"held out (by name), the effect is chosen by: {bags['rail_2']}",
        f"held out, errors are reported of: {bags['rail_1']}",
    ]


def test_a_bag_for_choosing_counts_as_fitted(bags: dict[str, Path], calls: dict[str, Any]) -> None:
    spare = (str(bags["rail_2"]), str(bags["road"]))
    traced = trace_bags([bags["rail_1"]], SUBJECT, TraceOptions(held_out=spare))
    assert [of["use"] for of in trace_document(traced)["bags"]] == ["train", "choose", "held_out"]
    assert role_of(traced_subject(traced), source_of(bags["rail_2"])) == "fitted"
    assert role_of(traced_subject(traced), source_of(bags["road"])) == "held_out"


def test_validate_reports_a_bag_that_the_trace_was_fitted_to(
    bags: dict[str, Path], calls: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_traced(trace_bags(list(bags.values()), SUBJECT), tmp_path / "out", report=False)
    assert not (tmp_path / "out" / "trace.html").exists()
    for name, expected in (("road", True), ("rail_2", False)):
        assert main(["validate", str(bags[name]), "--subject", str(tmp_path / "out" / "subject.yaml"), "--json"]) == 0
        document = json.loads(capsys.readouterr().out)
        assert ("fitted_to" in {finding["what"] for finding in document["findings"]}) is expected


def test_a_failing_page_keeps_the_other_files(tmp_path: Path) -> None:
    trace = found(verdict="unknown")
    (tmp_path / "trace.html").write_text("of the trace before")
    with pytest.raises(InputError, match=r"trace\.html: cannot be drawn \(KeyError"):
        write_traced(Report(trace), tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["subject.yaml", "trace.json"]


def test_each_stage_has_its_line() -> None:
    seen: list[str] = []

    class Line:
        def __init__(self, what: str) -> None:
            self.what = what

        def __enter__(self) -> Any:
            return lambda done, total: seen.append(f"{self.what} {done}/{total}")

        def __exit__(self, *_: object) -> None:
            seen.append(f"{self.what} ends")

    with stage_lines(Line) as on_stage:
        on_stage("screening", 0.5)
        on_stage("refitting", 0.0)
        on_stage("refitting", 1.0)
    assert seen == ["screening 500/1000", "screening ends", "refitting 0/1000", "refitting 1000/1000", "refitting ends"]


def test_the_command_traces_and_prints(
    bags: dict[str, Path], calls: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["trace", str(bags["rail_1"]), "--hold-out", str(bags["road"]), "--subject", "subject_1", "--seed", "5"]
    assert main([*command, "-o", str(tmp_path / "a"), "--json", "--no-report"]) == 0
    assert json.loads(capsys.readouterr().out)["seed"] == calls["seed"] == 5
    assert main([*command, "-o", str(tmp_path / "b"), "--case", f"{bags['road']}=gravel"]) == 0
    assert capsys.readouterr().out.startswith("Missing in the model: stop")
    assert calls["held_out"][0].case == "gravel"
    assert main([*command, "-o", str(tmp_path / "c"), "--no-report", "--shocks", "2", "--most-effects", "1"]) == 0
    assert (calls["settings"].floor.shocks, calls["settings"].most_effects) == (2, 1)
    assert (tmp_path / "b" / "trace.html").exists() and not (tmp_path / "c" / "trace.html").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--subject", "subject_1"], "no bag is given"),
        (["{rail_1}", "--subject", "nobody"], "no subject file nobody"),
        (["{rail_1}", "{rail_1}", "--subject", "subject_1"], "given twice"),
        (["{rail_1}", "--hold-out", "{rail_1}", "--subject", "subject_1"], "given twice"),
        (["{rail_1}", "{twin}", "--subject", "subject_1"], "the same recording as"),
        (["{rail_1}", "--hold-out", "{twin}", "--subject", "subject_1"], "the same recording as"),
        (["{rail_1}", "--case", "rail", "--subject", "subject_1"], "expected BAG=CASE"),
        (["{rail_1}", "--case", "other.mcap=road", "--subject", "subject_1"], "no such bag is given"),
        (["missing.mcap", "--subject", "subject_1"], "missing.mcap: cannot be read"),
    ],
)
def test_bad_input_is_one_line(
    arguments: list[str], message: str, bags: dict[str, Path], calls: dict[str, Any], tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    names = {name: str(path) for name, path in bags.items()}
    names["twin"] = shutil.copy(bags["rail_1"], tmp_path / "rail_9.mcap")
    given = [text.format(**names) for text in arguments]
    assert main(["trace", *given, "-o", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1
    assert not (tmp_path / "out").exists() and not calls


def test_an_output_that_is_a_file_is_refused_before_the_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    for place in (tmp_path / "file", tmp_path / "file" / "below"):
        assert main(["trace", "missing.mcap", "--subject", "subject_1", "-o", str(place)]) == 2
        assert "file: is a file; the results need a directory" in capsys.readouterr().err
    check_directory(tmp_path / "new" / "out")
