"""The words of a trace: verdicts, probabilities and findings, in the terminal and on the page."""

from __future__ import annotations

import dataclasses
import json
import re

import numpy as np
import pytest
from traces import (
    EVENTS,
    FRICTION,
    NAN,
    PROBABILITIES,
    STOP,
    SUBJECT,
    VERDICTS,
    a_round,
    applied,
    drawn,
    found,
    nothing,
    page_of,
)

from biodyn_core.effects import CATALOGUE, AppliedEffect
from biodyn_core.tracing.findings import (
    FurtherRecordings,
    LouderRecordings,
    RankedCandidate,
    Round,
    SensorFinding,
)
from biodyn_ros.trace.document import PROOF, trace_document
from biodyn_ros.trace.errors import mean_errors
from biodyn_ros.trace.report import Report
from biodyn_ros.trace.text import text_of
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


def test_none_is_green_only_without_another_answer_in_the_set() -> None:
    trace = found("none")
    alone, beside = (dataclasses.replace(trace.rounds[0], likely=likely) for likely in (("none",), ("none", "clock")))
    sure, unsure = (Report(dataclasses.replace(trace, rounds=(one,))) for one in (alone, beside))
    assert (tone(sure), tone(unsure)) == ("good", "warn")
    assert "Not excluded" not in headline(sure.trace)
    assert headline(unsure.trace).startswith("No missing effect found. Not excluded: clock.")


def test_the_mean_error_is_unknown_if_an_event_is_unstable() -> None:
    known = [event.before for event in found().events if event.use == "held_out"]
    unstable = dataclasses.replace(known[0], nrmse_rms_percent=np.full(5, np.nan))
    assert mean_errors(known)["all"] is not None
    assert set(mean_errors([*known, unstable]).values()) == {None}


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
    assert by_verdict["none"] == "No missing effect found. Held-out error 20.0 % with refitted parameters."
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
        "The probability that nothing visible is missing is 0.85. In simulation an effect was named in 3 of 40 bodies"
        " with a ratio of 0.5, in 12 of 30 with 1. A smaller effect may be present."
    )
    assert of["unexplained"].startswith("The probability of an effect outside the catalogue is 0.55. ")
    assert "ratio" not in reliability(found("none", named_bodies=()))


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
    assert "Also possible stop in the joint between pelvis and lower torso" in page_of(trace, draws=False)[1].text


def test_probabilities_never_exclude_an_answer() -> None:
    assert [probability(p) for p in (0.0, 0.004, 0.005, 0.5, 0.994, 0.995, 1.0)] == [
        "< 0.01", "< 0.01", "0.01", "0.50", "0.99", "> 0.99", "> 0.99",
    ]  # fmt: skip
    assert probability(NAN) == "–"
    close = dataclasses.replace(a_round("ambiguous"), answers={"dry_friction": 0.7996, "none": 0.2004})
    assert "mechanism dry friction is 0.7996" in reliability(found("ambiguous", rounds=(close,)))  # 0.80 would be named
    named = dataclasses.replace(close, answers={"dry_friction": 0.8004, "none": 0.1996})
    assert "mechanism dry friction is 0.80," in reliability(found("effect", rounds=(named,)))
    assert [probability(p, 0.8) for p in (0.7996, 0.8, 0.85, 0.003, NAN)] == ["0.7996", "0.80", "0.85", "< 0.01", "–"]


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


def test_changes_of_the_effects_that_the_subject_had_are_listed() -> None:
    """Friction of 30 N in the file, 10 N after the refit, 9 N beside the added stop."""
    given, before, after = (
        dataclasses.replace(FRICTION, values={**FRICTION.values, "friction_n": value}) for value in (30.0, 10.0, 9.0)
    )
    subjects = {
        "given": dataclasses.replace(SUBJECT, effects=(given,)),
        "before": dataclasses.replace(SUBJECT, effects=(before,)),
        "after": dataclasses.replace(SUBJECT, effects=(after, STOP)),
    }
    report = Report(found(**subjects))
    change = trace_document(report)["parameters_moved"]["friction friction_n[pelvis]"]
    assert (change["given"], change["refitted"], change["with_effect"], change["unit"]) == (30.0, 10.0, 9.0, "N")
    assert "friction of friction, pelvis 30.0 to 10.0 (-66.7 %)" in " ".join(text_of(report).split())
    assert "friction of friction, pelvis" in page_of(report.trace, draws=False)[1].text


def test_the_terminal_has_every_reason() -> None:
    """The last ones say why nothing was added."""
    reasons = tuple(f"reason number {number}" for number in range(7))
    text = text_of(Report(found(reasons=reasons)))
    shown = [line for line in text.splitlines() if line.startswith("because: ")]
    assert shown == [f"because: {each}" for each in reasons]


def test_a_mechanism_without_a_fitted_candidate_has_its_name() -> None:
    bare = dataclasses.replace(a_round(), chosen=None)
    named = {"rounds": (bare,), "effects": (), "intervals": (), "after": SUBJECT, "ambiguous_with": ()}
    assert headline(found(**named)) == (
        "Found: nonlinear stiffness. Nothing is added to the subject. Held-out error 20.0 % with refitted parameters."
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
        " and again held out. With further recordings for both: twice the road: 10, all of these: 13"
    )
    for text in (" ".join(text_of(Report(trace)).split()), page_of(trace, draws=False)[1].text):
        assert line in text and "drive one shock" in text
    document = trace_document(Report(trace))["further_recordings"]
    assert document[0] == {"recordings": "the least data", "bodies": 24, "named": 9, "best": 14}
    assert [one["named"] for one in document] == [9, 10, 13]
    assert trace_document(Report(found()))["further_recordings"] == []


def test_without_a_single_cause_the_gain_of_louder_motion_is_stated() -> None:
    louder = (
        LouderRecordings("nonlinear_stiffness", 1.5, 8, 1, 2, 2, 5),
        LouderRecordings("dry_friction", 1.5, 6, 0, 0, 1, 3),
    )
    trace = found("ambiguous", louder=louder)
    line = (
        "the same drives with 1.5 times the motion: in simulation a decision that knows the true laws then names 5"
        " instead of 2 of 8 effects with nonlinear stiffness, 3 instead of 1 of 6 effects with dry friction, and the"
        " learned model 2 instead of 1 of these"
    )
    for text in (" ".join(text_of(Report(trace)).split()), page_of(trace, draws=False)[1].text):
        assert line in text
    first, _ = trace_document(Report(trace))["louder_recordings"]
    assert first == {
        "mechanism": "nonlinear_stiffness", "level": 1.5, "effects": 8, "named": 1, "named_louder": 2,
        "with_true_law": 2, "with_true_law_louder": 5,
    }  # fmt: skip
    assert trace_document(Report(found()))["louder_recordings"] == []


def test_without_a_verdict_one_list_has_the_missing_recordings() -> None:
    """The list appears once, its parts are the reasons, and empty sections are left out."""
    undecided = found("not_decidable", reasons=("too little", *found("not_decidable").lacking))
    document = trace_document(Report(undecided))
    assert (
        document["to_record"] == [{"use": "to fit", "road_s": 18.0, "shocks": 2, "hard_shocks": 1, "how": ()}]
        and json.loads(json.dumps(document))["to_record"][0]["how"] == []
    )
    for text in (" ".join(text_of(Report(undecided)).split()), page_of(undecided, draws=False)[1].text):
        assert text.count("18 s more road, 2 more shocks of 0.8 g, one of them of 2 g, to fit") == 1
        assert text.count("12 s without shocks, 30 are needed") == 1
    few = text_of(Report(found("not_decidable", events=EVENTS[:2], floor_percent=None)))
    assert "train, before" in few and "held out, before" not in few and "floor" not in few
    for text in (" ".join(text_of(Report(undecided)).split()), page_of(undecided, draws=False)[1].text):
        assert "record next" not in text.lower() and "what the recordings lack" not in text.lower()


def test_an_unsteady_effect_is_found_and_not_added() -> None:
    """A wandering line varies with time."""
    line = applied("periodic", "head")
    alone = found(effects=(line,), intervals=((),), after=SUBJECT)
    document = trace_document(Report(alone))
    assert [effect["added"] for effect in document["effects"]] == [False]
    assert headline(alone) == (
        "Found: periodic on the head. Nothing is added to the subject. Held-out error 20.0 % with refitted parameters."
    )
    assert "found, not added: periodic on the head" in " ".join(text_of(Report(alone)).split())
    _, page = page_of(alone, draws=False)
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
        " within the limit of 4.01 deg; it is not the named cause"
    )
    is_late = (
        "the sensor on the neck may have a clock offset of 0.600 ms, by the fit; beyond the limit of 0.500 ms; it is"
        " not the named cause (gain 0.200)"
    )
    terminal, page = " ".join(text_of(Report(quiet)).split()), page_of(quiet, draws=False)[1].text
    for line in (tilted, is_late):
        assert f"sensor: {line}" in terminal and line[1:] in page
    assert "do not depend on the verdict" in page and "do not depend on the verdict" not in drawn("none")[1].text
    (loud,) = sensor_lines(found(sensors=(LOUD,)))
    assert "a gain error of 1.00 %" in loud and "within the limit of 1.52 %" in loud and "it is the named cause" in loud


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
    assert "a gain of 0.810 (stop in" in page_of(found(), draws=False)[1].text
