"""The page of the study of predictions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from biodyn_core.base.quantiles import NORMAL_95
from biodyn_core.exposure.figure_spread import ACCEL_FACTORS, FORCE_FACTORS
from biodyn_core.pipeline.fit_monitor import MonitorSettings
from blind.predictions.calibrate import Calibration
from blind.predictions.driven import FIGURES, Drive
from blind.predictions.people import FIT, HELD, LEVELS, OTHER_KIND
from blind.predictions.score import LEAST_RATIO, WITHIN_S, Answer, Scored, answer, covered, factor_of, resampled, scored
from blind.requirements import Mark, mark_table
from conformance.table import table

_TIMES: Final = ", ".join(f"{level:g}" for level in LEVELS)

HEAD: Final = f"""\
# Predictions: are they as sure as they say?

Made by `make blind ARGS=predictions`, which ends with an error if a requirement is missed. Do not edit.

People are drawn from the whole of Table 1 in `test/world`, which shares no code with the package and has another
integrator. Nine of ten have a background that the model lacks: friction, hysteresis, relaxation, tissue, coupling with
the horizontal, errors of mounting and clocks, and more, from weak to strong. Each person sits for a fit: {FIT} events
of each kind of motion are fitted to and {HELD} are held out; {100 * OTHER_KIND:.0f} % of people have no event of one
kind there. Then the person is driven through events of all kinds, at {_TIMES} times the level of the fit.
The package has the raw streams of the sensors, and the truth is not available to it.

With two of three people an effect of the catalogue begins in the middle of the drive: in forms of the simulation, made
for a ratio of 0.8 to 4 (rms of its residual over that of background and noise, as far as a refit does not absorb
it). Classes are drawn evenly, sensors and posture among them. Events before it are those without an effect.

The factors of the intervals and the settings of the fit monitor were chosen on other people (below), with other seeds
and fewer kinds of background and forms of effects.
"""

FIGURE_WORDS: Final = {
    "aw": "aw of a segment", "vdv": "VDV of a segment", "peak": "weighted peak of a segment",
    "rms": "rms of a joint's force", "compression": "largest compression", "tension": "largest tension",
}  # fmt: skip
COVERAGE: Final = (90.0, 98.0)
HOURS: Final = 8.0


def marks(drives: Sequence[Drive]) -> list[Mark]:
    """All requirements."""
    found, answers = list(scored(drives)), [answer(drive) for drive in drives]
    least, most = COVERAGE
    rows = []
    for figure in FIGURES:
        share = covered([one for one in found if one.figure == figure])
        rows.append(
            Mark(
                f"coverage, {FIGURE_WORDS[figure]}",
                f"{least:g} to {most:g} %",
                f"{share:.1f} %",
                least <= share <= most,
            )
        )
    hours, alarms = _hours(drives), sum(one.false_alarms for one in answers)
    rate = alarms * HOURS / hours
    reached = f"{rate:.1f} ({alarms} in {hours:.1f} hours{'' if hours >= HOURS else ', too few'})"
    what = f"false alarms in {HOURS:g} hours of drive without an effect"
    rows.append(Mark(what, "<= 1", reached, hours >= HOURS and rate <= 1.0))
    return rows


def _hours(drives: Sequence[Drive]) -> float:
    """Hours without an effect."""
    return sum(drive.seconds for drive in drives) / 3600.0


def rendered(drives: Sequence[Drive], calibration: Calibration, date: str) -> str:
    """The page."""
    found, answers = list(scored(drives)), [answer(drive) for drive in drives]
    parts = [
        [*mark_table(marks(drives)), ""],
        _coverage(found),
        _curves(drives),
        _misfits(answers),
        _calibration(calibration),
    ]
    people = (
        f"Run of {date}: {len(drives)} people, {_hours(drives):.1f} hours without an effect. The fits leave"
        f" {np.median([drive.error_percent for drive in drives]):.1f} % of the measured rms in the median."
    )
    return "\n".join([HEAD, people, "", *(line for part in parts for line in part)]).rstrip() + "\n"


def _coverage(found: Sequence[Scored]) -> list[str]:
    groups = [(FIGURE_WORDS[figure], [one for one in found if one.figure == figure]) for figure in FIGURES]
    conditions = dict.fromkeys(one.condition for one in found)
    groups += [(words, [one for one in found if one.condition == words]) for words in sorted(conditions)]
    rows = [[words, *_covered(group)] for words, group in groups if group]
    return [
        "## Intervals",
        "",
        "Share of the true figures within their 95 % interval, with its own interval by resampling whole people; the",
        "median half width of the intervals, and the median error; and the share within the interval if only the",
        "covariance of the parameters counted. Forces are for the assumed mass of the body.",
        "",
        *table(["figures", "number", "covered", "its interval", "half width", "error", "parameters alone"], rows),
        "",
    ]


def _covered(group: Sequence[Scored]) -> list[str]:
    low, high = resampled(group)
    half = [NORMAL_95 * np.hypot(factor_of(one.figure) * one.model, one.parameters) for one in group]
    alone = np.mean([abs(one.log_ratio) <= NORMAL_95 * one.parameters for one in group])
    return [
        str(len(group)), f"{covered(group):.1f} %", f"{low:.1f} to {high:.1f} %", f"{100 * np.median(half):.1f} %",
        f"{100 * np.median([abs(one.log_ratio) for one in group]):.1f} %", f"{100 * alone:.0f} %",
    ]  # fmt: skip


def _curves(drives: Sequence[Drive]) -> list[str]:
    within = np.array([of.within for drive in drives for of in drive.figures])
    share = 100.0 * float(np.nanmean(within))
    return [
        f"The true acceleration lies within the band of the curves {share:.1f} % of the time in motion. The band has",
        "no factor: it is made for the whole residual, also for its part out of phase.",
        "",
    ]


def _misfits(answers: Sequence[Answer]) -> list[str]:
    hidden = [one for one in answers if one.counts]
    changing = [one for one in answers if one.drive.drifts]
    kinds = sorted({one.drive.kind for one in hidden})
    groups = [("all", hidden)] + [(kind, [one for one in hidden if one.drive.kind == kind]) for kind in kinds]
    rows = [
        [kind, str(len(group)), f"{sum(one.in_time for one in group)}", _delay(group), f"{_ratio(group):.1f}"]
        for kind, group in groups
    ]
    return [
        "## When the model stops fitting",
        "",
        f"Alarms before the effect are false, and so are those of people without one. The stiffness of {len(changing)}",
        "people drifts in the background, so that they do change. Their alarms count as false all the same:",
        f"{sum(one.false_alarms for one in changing)} in {_hours([one.drive for one in changing]):.1f} hours.",
        "",
        f"Effects of ratio {LEAST_RATIO:g} and more that begin in mid-drive, those found within {WITHIN_S:g} s of",
        "motion, the median delay in seconds of motion (of all of them, the missed ones included), and their median",
        "ratio.",
        "",
        *table(["effect", "people", "found in time", "median delay, s", "median ratio"], rows),
        "",
    ]


def _delay(group: Sequence[Answer]) -> str:
    delay = float(np.median([np.inf if one.delay_s is None else one.delay_s for one in group]))
    return f"{delay:.0f}" if np.isfinite(delay) else "not found"


def _ratio(group: Sequence[Answer]) -> float:
    return float(np.median([one.drive.ratio or np.nan for one in group]))


def _calibration(found: Calibration) -> list[str]:
    now = MonitorSettings()
    rows = [
        ["factor of aw and VDV", f"{found.accel.doses:.3f}", f"{ACCEL_FACTORS.doses:g}"],
        ["factor of weighted peaks", f"{found.accel.peaks:.3f}", f"{ACCEL_FACTORS.peaks:g}"],
        ["factor of the rms of forces", f"{found.force.doses:.3f}", f"{FORCE_FACTORS.doses:g}"],
        ["factor of the peaks of forces", f"{found.force.peaks:.3f}", f"{FORCE_FACTORS.peaks:g}"],
        ["allowance of the monitor", f"{found.monitor.allowance:g}", f"{now.allowance:g}"],
        ["threshold of the monitor", f"{found.monitor.threshold:g}", f"{now.threshold:g}"],
    ]
    return [
        "## Calibration",
        "",
        f"On the people for calibration without drift: {found.false_alarms} false alarms in {found.hours:.1f} hours.",
        f"{100 * found.in_time:.0f} % of the effects are found in time there.",
        "",
        "The package has the factors chosen there, rounded up, and the settings of the monitor.",
        "",
        *table(["", "chosen there", "in the package"], rows),
        "",
    ]
