"""The text output of `biodyn check-sensors`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

from biodyn_core.base.wording import counted, number
from biodyn_core.sensor_pairs.checks import Finding, SensorCheck, StretchCheck
from biodyn_core.tracing.findings import NAMING, Verdict
from biodyn_ros.base.wording import table, with_interval
from biodyn_ros.check_sensors.checking import Report, SensorPair
from biodyn_ros.check_sensors.evidence import sentence_of


class Fault(NamedTuple):
    """The name of a fault, its printed unit, the factor from SI to that unit, and the remedy."""

    title: str
    unit: str
    factor: float
    remedy: str


FAULTS: Final[Mapping[str, Fault]] = {
    "clock": Fault("delay", "ms", 1e3, "check the driver's stamps and the synchronisation of the clocks"),
    "drift": Fault("clock drift", "ppm", 1e6, "synchronise the clocks, or compare with --time log"),
    "gain": Fault("gain", "%", 1e2, "check the range, the unit and the calibration"),
    "tilt": Fault("tilt", "deg", 180.0 / math.pi, "check whether the sensor has turned in its mounting"),
    "skin": Fault("soft mounting", "ms", 1e3, "check tape, strap and screws"),
    "saturation": Fault("clipping", "m/s^2", 1.0, "use a larger range: peaks above the limit are lost"),
}

RESULTS: Final[Mapping[Verdict, str]] = {
    "none": "no fault found",
    "unexplained": "changed, no fault explains it",
    "not_decidable": "not decidable",
}

REMEDIES: Final[Mapping[Verdict, str]] = {
    "none": "a fault that changes the channel by less than 0.8 of the background may be missed",
    "unexplained": "compare mounting, posture and load with the good recording, and record a good one again",
    "not_decidable": "use a recording with more motion or a reference nearer to the sensor",
}

HEADS: Final = (
    "sensor", "by", "axis", "result", "size", "95 % interval", "", "background", "before", "after", "stretches",
)  # fmt: skip
LEGEND: Final = (
    "background, before, after: error of the prediction in % of the channel's rms: within the good recording, in the"
    " checked one, and there with the fault"
)


def text_of(report: Report) -> str:
    """The report as text for the terminal."""
    good = ", ".join(report.good) or f"its first {number(report.options.good_until_s)} s"
    pairs = counted(len(report.results), "pair")
    lines = [f"{report.bag}: {report.seconds:.1f} s, {pairs}, against a good recording: {good}", ""]
    heads = (
        "sensor",
        "by",
        "axis",
        "result",
        "size",
        "95 % interval",
        "",
        "background",
        "before",
        "after",
        "stretches",
    )
    lines += table([heads, *(_row(pair, result) for pair, result in report.results)], left=(0, 1, 2, 3, 6))
    lines += ["", LEGEND]
    lines += _explained(report)
    for name in report.suspects:
        lines += ["", f"{name}: its two pairs show opposite faults, which indicates {name} itself"]
    verdicts = dict.fromkeys("effect" if f.verdict in NAMING else f.verdict for f in _findings(report))
    lines += ["", "how sure, one stretch each (docs/check_sensors.md):"]
    lines += [f"  {_verdict_title(verdict)}: {sentence_of(verdict)}" for verdict in verdicts]
    return "\n".join([*lines, *(f"note: {line}" for line in report.notes)])


def _findings(report: Report) -> list[Finding]:
    return [result.finding for _, result in report.results]


def _verdict_title(verdict: Verdict) -> str:
    return "a named fault" if verdict in NAMING else RESULTS[verdict]


def _row(pair: SensorPair, result: SensorCheck) -> tuple[str, ...]:
    found = result.finding
    size, interval, unit = "–", "–", ""
    if found.name:
        fault = FAULTS[found.name]
        ends = [fault.factor * value for value in (found.size, found.lower, found.upper)]
        size, lower, upper = with_interval(*(None if math.isnan(value) else value for value in ends))
        interval = _interval(found, lower, upper)
        unit = fault.unit
    errors = (found.background_percent, found.before_percent, found.after_percent)
    stretches = f"{found.agreeing} of {found.decidable}" if found.decidable else "–"
    percents = [number(value if math.isfinite(value) else None) for value in errors]
    return (*pair, result.axis or "–", _title(found), size, interval, unit, *percents, stretches)


def _interval(found: Finding, lower: str, upper: str) -> str:
    """The ends of an interval; one end where the size is at the end of the searched range."""
    if math.isnan(found.lower):
        return "–"
    if math.isinf(found.upper):
        return f"at least {lower}"
    return f"at most {upper}" if math.isinf(found.lower) else f"{lower} to {upper}"


def _title(found: Finding) -> str:
    if not found.name:
        return RESULTS[found.verdict]
    return " or ".join(FAULTS[name].title for name in (found.name, *found.ambiguous_with))


def _explained(report: Report) -> list[str]:
    """The reasons, remedies and differing stretches of all pairs, pairs with the same text together."""
    pairs: dict[tuple[str, ...], list[str]] = {}
    for pair, result in report.results:
        pairs.setdefault(tuple(_explanation(pair, result, report.good)), []).append(
            f"{pair.under_test} by {pair.reference}"
        )
    return [line for (first, *more), all_of in pairs.items() for line in ("", f"{', '.join(all_of)}: {first}", *more)]


def _explanation(pair: SensorPair, result: SensorCheck, good: Sequence[str]) -> list[str]:
    """The reason and the remedy of a finding, and the stretches where they differ."""
    found = result.finding
    lines = [found.reason]
    if found.agreeing < found.decidable or len({one.found.name for one in result.checks}) > 1:
        lines += [f"  {_stretch(one, good)}" for one in result.checks]
    if found.name:
        lines += [f"  {FAULTS[name].title}: {FAULTS[name].remedy}" for name in (found.name, *found.ambiguous_with)]
        if found.name != "saturation":
            lines.append(
                f"  the opposite fault of {pair.reference} gives the same result: check both by a third sensor (--pair)"
            )
    elif result.checks:
        lines.append(f"  {REMEDIES[found.verdict]}")
    return lines


def _stretch(one: StretchCheck, good: Sequence[str]) -> str:
    found = one.found
    against = f", against {good[one.good]}" if len(good) > 1 else ""
    where = f"{one.span.begin_s:.1f} to {one.span.end_s:.1f} s{against}"
    if not found.name:
        return f"{where}: {RESULTS[found.verdict]}, before {number(found.before_percent)} %"
    fault = FAULTS[found.name]
    return f"{where}: {fault.title} {number(fault.factor * found.size)} {fault.unit}"
