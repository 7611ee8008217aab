"""The page of a trace."""

from __future__ import annotations

import dataclasses
import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from pages import NASTY, assert_self_contained, lines, svg_text
from traces import (
    DRAWN,
    EVENTS,
    RATE_HZ,
    STOP,
    SUBJECT,
    VERDICTS,
    a_round,
    applied,
    diagnostics,
    drawn,
    errors,
    found,
    nothing,
    page_of,
    restoring,
)

from biodyn_core.base.segments import MEASURED_SEGMENTS
from biodyn_core.body.parameters import UNFITTED
from biodyn_core.tracing.findings import (
    ComparedEvent,
    NuisanceValue,
    Verdict,
)
from biodyn_ros.reports.residuals import AFTER_COLOUR, BEFORE_COLOUR, residual_spectra, windowed
from biodyn_ros.trace.document import PROOF, trace_document
from biodyn_ros.trace.drawings import REST_COLOUR, force_panels, ranking
from biodyn_ros.trace.page import worst_event
from biodyn_ros.trace.report import Report
from biodyn_ros.trace.wording import (
    headline,
    reliability,
    tone,
)


@pytest.mark.parametrize("verdict", VERDICTS)
def test_every_verdict_has_a_page(verdict: Verdict) -> None:
    source, page = drawn(verdict)
    trace = found(verdict)
    for expected in (
        headline(trace), reliability(trace), *MEASURED_SEGMENTS, *(each.name for each in EVENTS), PROOF,
        "Stop at pelvis: gain 0.81.", "clock of the neck's sensor +3.10", "bending at neck", "sensor was loose",
        "damping ratio, head", *(("m/s²", "(m/s²)²/Hz", "Hz") if verdict in DRAWN else ()),
    ):  # fmt: skip
        assert expected.replace("_", " ") in page.text.replace("_", " "), expected
    for drawing in re.findall(r"<svg.*?</svg>", source, flags=re.DOTALL):
        ET.fromstring(drawing)
    assert source.count("<svg") == {"unexplained": 4, "not_decidable": 2}.get(verdict, 3)
    assert ("Probabilities answer probability in the 90 % set" in page.text) is (verdict != "not_decidable")
    assert ("Ratio: rms of the change" in page.text) is (verdict == "none")
    assert ("missing force, N" in page.text) is (verdict == "unexplained")


def test_the_missing_force_is_drawn_before_and_after_with_its_law() -> None:
    _, page = page_of(found(restoring_forces=(restoring(STOP),)))
    drawing = str(force_panels(restoring(STOP)))
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
    source, page = page_of(found(restoring_forces=forces))
    assert source.count("<svg") == 5
    of_rate, without_law = (svg_text(str(force_panels(each))) for each in forces)
    assert "velocity relative to the seat, m/s" in of_rate
    assert "force of the effect" not in without_law
    assert "87.0 N needed to move the segment" in page.text
    assert "Joint between central torso and upper torso" in page.text and "so there is no law" in page.text
    assert page.text.count("The central torso has no sensor") == 1  # the joint's, not the segment's


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
    page = page_of(found(rounds=(a_round(), second)), draws=False)[1].text
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


def test_an_event_in_which_a_model_diverges_is_in_no_spectrum() -> None:
    """Else the curve of that model had the power of the other events alone, below those of the others."""
    *others, calm, hard = EVENTS
    lost = dataclasses.replace(hard, after_mps2=np.full_like(hard.after_mps2, np.nan))
    frequency, density = residual_spectra([calm])
    for events in ([calm, lost], [lost, calm], [calm, dataclasses.replace(lost, rate_hz=2.0 * RATE_HZ)]):
        for found_here, expected in zip(residual_spectra(events), (frequency, density), strict=True):
            np.testing.assert_array_equal(found_here, expected)
    assert residual_spectra([lost]) is None
    text = page_of(found(events=(*others, calm, lost)))[1].text
    assert "residual after (thin), over 1 of 2 events held out, without 1 in which a model diverges." in text
    other_rate = dataclasses.replace(calm, name="road_3", rate_hz=2.0 * RATE_HZ)
    text = page_of(found(events=(*others, calm, lost, other_rate)), draws=False)[1].text
    assert "over 1 of 3 events of one sampling rate held out, without 1 in which a model diverges." in text
    assert "over 2 events held out." in drawn("effect")[1].text
    text = page_of(found(events=(lost,)))[1].text
    assert "There is no spectrum: a model diverges in each event." in text
