"""The document of a trace."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path
from typing import Any

import pytest
from pages import Page, empty_drawings
from traces import (
    EVENTS,
    NAN,
    STOP,
    SUBJECT,
    VERDICTS,
    a_round,
    diagnostics,
    errors,
    found,
    given,
    nothing,
    page_of,
    restoring,
)

from biodyn_core.base.segments import MEASURED_SEGMENTS
from biodyn_core.body.parameters import PARAMETERS, UNFITTED, Parameters
from biodyn_core.body.subject import Subject
from biodyn_core.effects import CATALOGUE
from biodyn_core.tracing.findings import (
    NamedBodies,
    Verdict,
)
from biodyn_ros.reading.provenance import Source
from biodyn_ros.trace.document import PROOF, refit_document, trace_document
from biodyn_ros.trace.page import trace_page
from biodyn_ros.trace.refit import Refit, refit_of
from biodyn_ros.trace.report import Report
from biodyn_ros.trace.text import text_of


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
    assert document["named_in_simulation"] == []
    of_none = trace_document(Report(found("none")))
    assert of_none["power"] == 3 / 40
    assert of_none["named_in_simulation"][1] == {"ratio": 1.0, "bodies": 30, "named": 12}
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
        found(verdict, diagnostics=lost, floor_percent=NAN, p_value=NAN, named_bodies=(NamedBodies(0.5, 0, 0),)),
    ):
        document = trace_document(Report(trace))
        json.dumps(document, allow_nan=False)
        text_of(Report(trace))
    if verdict == "unexplained":  # the one page with every drawing
        assert "nan" not in page_of(trace)[1].text.lower().split()


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


def test_a_given_subject_that_diverges_has_no_mean_error() -> None:
    """In the second of two events for fitting; a mean over the first one is not comparable with that over both."""
    first, second, *others = EVENTS
    diverging = dataclasses.replace(second, given=errors(second.name, second.case, [NAN] * 5))
    trace = found("not_decidable", events=(first, diverging, *others))
    made = refit_of(trace, [Source("a")])
    assert made is not None
    document = refit_document(made)
    assert document["error_percent"] == {"given": None, "refitted": pytest.approx(19.0)}
    assert document["text"].endswith(
        "; there the model diverges in 1 of 2 events with the given parameters, and the error is 19.0 % of the"
        " measured rms with the refitted ones"
    )


def test_the_recordings_of_the_given_fit_that_are_used_again_are_counted() -> None:
    """Three parts of one recording are one of that fit; a whole recording has all three parts of that fit."""
    whole = given(SUBJECT, fitted=[{"bag": "a.mcap", "sha256": "a"}, {"bag": "b.mcap", "sha256": "b"}])
    three = [Source("a", 0.0, 10.0), Source("a", 20.0, 30.0), Source("a", 40.0, 50.0)]
    made = refit_of(found("not_decidable", given=whole), three)
    assert made is not None and (made.recordings, made.given_recordings, made.shared_recordings) == (3, 2, 1)
    assert "the 2 recordings of that fit, of which 1 is used here" in made.text
    parts = given(SUBJECT, fitted=[{"bag": "a.mcap", **part.to_dict()} for part in three])
    made = refit_of(found("not_decidable", given=parts), [Source("a")])
    assert made is not None and (made.recordings, made.given_recordings, made.shared_recordings) == (1, 3, 3)
    assert "the 3 recordings of that fit, of which all are used here" in made.text
    alone = given(SUBJECT, fitted=[{"bag": "a.mcap", "sha256": "a"}])
    assert "only for the 1 recording of that fit, which is used here;" in refit(alone, "a", "b").text
    assert "only for the 1 recording of that fit, which is not used here;" in refit(alone, "b").text


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
