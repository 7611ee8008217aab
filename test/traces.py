"""Invented traces of every verdict, and their pages."""

from __future__ import annotations

import dataclasses
import math
from contextlib import nullcontext
from functools import cache
from typing import Any, get_args

import numpy as np
import pytest
from pages import Page, empty_drawings, no_drawings
from streams import subject

from biodyn_core.body.parameters import Parameters
from biodyn_core.body.subject import Subject
from biodyn_core.effects import CATALOGUE, AppliedEffect
from biodyn_core.identification.problem import Errors
from biodyn_core.tracing.findings import (
    ComparedEvent,
    Diagnostics,
    ForceProfile,
    Interval,
    NamedBodies,
    Need,
    NuisanceValue,
    RankedCandidate,
    RestoringForce,
    Round,
    Surface,
    Trace,
    Verdict,
)
from biodyn_ros.trace.page import trace_page
from biodyn_ros.trace.report import Report

SUBJECT = subject()
RATE_HZ = 200.0
VERDICTS = get_args(Verdict)
DRAWN = ("effect", "unexplained")
"""Verdicts whose pages have every kind of drawing."""


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
        named_bodies=(NamedBodies(0.5, 40, 3), NamedBodies(1.0, 30, 12)) if verdict == "none" else (),
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


def page_of(trace: Trace, draws: bool = True, **more: Any) -> tuple[str, Page]:
    """The page of a trace with empty drawings; their figures are made unless a test is of the text alone."""
    with empty_drawings() if draws else no_drawings():
        source = trace_page(Report(trace, **more))
    return source, Page(source)


@cache
def drawn(verdict: Verdict) -> tuple[str, Page]:
    """The page of a verdict, with its drawings or, for the same drawings of another verdict, with empty ones."""
    report = Report(found(verdict), dealt="dealt by turns")
    with nullcontext() if verdict in DRAWN else empty_drawings():
        source = trace_page(report)
    return source, Page(source)
