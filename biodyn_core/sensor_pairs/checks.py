"""Check of one sensor by another one over recordings: some stretches, each against every good recording."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from biodyn_core.sensor_pairs.pairs import PairCheck, check
from biodyn_core.sensor_pairs.settings import PairSettings, StretchSettings
from biodyn_core.sensor_pairs.streams import LEAST_RATE_HZ, Span, Stream, common_spans, pair_of
from biodyn_core.tracing.findings import NAMING, Verdict

CLIPPED: Final = "saturation"
CLOCKS: Final = ("clock", "drift")
"""A drift of an earlier begin is an offset that differs between stretches: they count as one finding."""


class Recorded(NamedTuple):
    """Both streams of a pair in one recording: the reference, and the sensor under test."""

    reference: Stream
    under_test: Stream


@dataclass(frozen=True, eq=False)
class StretchCheck:
    """One check: the number of the good recording and its stretch, the checked stretch, and the result."""

    good: int
    good_span: Span
    span: Span
    found: PairCheck


@dataclass(frozen=True, eq=False)
class Finding:
    """The common finding of several checks of one sensor.

    name: the fault, empty without one; agreeing, decidable: how many checks show it, of how many that decide. size:
    median of the agreeing ones; lower, upper: hull of their 95 % intervals, NaN without one. The percentages are
    medians of the agreeing ones, as in `PairCheck`, NaN if unknown.
    """

    verdict: Verdict
    reason: str
    name: str = ""
    ambiguous_with: tuple[str, ...] = ()
    size: float = math.nan
    lower: float = math.nan
    upper: float = math.nan
    unit: str = ""
    agreeing: int = 0
    decidable: int = 0
    background_percent: float = math.nan
    before_percent: float = math.nan
    after_percent: float = math.nan


@dataclass(frozen=True, eq=False)
class SensorCheck:
    """The result for a pair of sensors, with all its checks; axis: of the sensor under test, empty without a check.

    uses_gyro: whether the gyro of the reference is an input.
    """

    finding: Finding
    axis: str = ""
    rate_hz: float = math.nan
    uses_gyro: bool = False
    checks: tuple[StretchCheck, ...] = ()


def check_sensor(
    checked: Recorded, good: Sequence[Recorded], seed: int, stretches: StretchSettings, settings: PairSettings
) -> SensorCheck:
    """Check a sensor in the stretches of a recording, each against the best stretch of every good recording."""
    everything = (checked, *good)
    slowest_hz = min(stream.rate_hz for one in everything for stream in one)
    if slowest_hz < LEAST_RATE_HZ:
        return _undecided(f"a rate of {slowest_hz:.1f} Hz is too low: at least {LEAST_RATE_HZ:g} Hz is needed")
    rate_hz = min(stretches.highest_rate_hz, slowest_hz)
    learnt = [_spans(one, 1, stretches, settings) for one in good]
    spans = _spans(checked, stretches.stretches, stretches, settings)
    for whose, recorded, found in (("checked", checked, spans), *zip(["good"] * len(good), good, learnt, strict=True)):
        if not found:
            return _undecided(f"the {whose} recording: {_why_no_stretch(recorded, stretches, settings)}")
    uses_gyro = all(one.reference.gyro_radps is not None for one in everything)
    axis = int(np.argmax(np.abs(good[0].under_test.accel_mps2.mean(axis=0))))
    checks = []
    for number, (recorded, found) in enumerate(zip(good, learnt, strict=True)):
        for good_span in found:
            baseline = pair_of(*recorded, good_span, axis, rate_hz, uses_gyro)
            for span in spans:
                result = _constant(recorded, good_span, checked, span)
                if result is None:
                    result = check(pair_of(*checked, span, axis, rate_hz, uses_gyro), baseline, seed, settings)
                checks.append(StretchCheck(number, good_span, span, result))
    return SensorCheck(combined([one.found for one in checks]), "xyz"[axis], rate_hz, uses_gyro, tuple(checks))


def _constant(good: Recorded, good_span: Span, checked: Recorded, span: Span) -> PairCheck | None:
    """The check of stretches in which a sensor repeats one reading; None where both move in both recordings.

    In the checked recording a sensor that does so beside one that moves is stuck, which no fault explains.
    """
    if whose := _still(good, good_span):
        return PairCheck("not_decidable", f"in the good recording {whose} one constant reading")
    whose = _still(checked, span)
    verdict: Verdict = "not_decidable" if whose == _BOTH else "unexplained"
    return PairCheck(verdict, f"{whose} one constant reading") if whose else None


_BOTH: Final = "both sensors give"


def _still(recorded: Recorded, span: Span) -> str:
    """Which sensors repeat one reading in a stretch, with the verb; empty if none."""
    reference, under_test = (
        not np.ptp(stream.between(span.begin_s, span.end_s).accel_mps2, axis=0).any() for stream in recorded
    )
    if reference and under_test:
        return _BOTH
    return "the reference gives" if reference else "the sensor gives" if under_test else ""


def _spans(recorded: Recorded, count: int, stretches: StretchSettings, settings: PairSettings) -> list[Span]:
    """The stretches of a recording: of the set length, or of the least one if no longer one exists."""
    common_s = _common_s(recorded)
    lengths_s = (min(stretches.stretch_s, common_s), settings.least_s)
    for length_s in (length_s for length_s in lengths_s if settings.least_s <= length_s <= common_s):
        if found := common_spans(*recorded, count, length_s, stretches):
            return found
    return []


def _common_s(recorded: Recorded) -> float:
    """The time that both streams share, negative where they do not overlap."""
    return min(s.stamps_s[-1] for s in recorded) - max(s.stamps_s[0] for s in recorded)


def _why_no_stretch(recorded: Recorded, stretches: StretchSettings, settings: PairSettings) -> str:
    common_s = _common_s(recorded)
    if common_s <= 0.0:
        return "the stamps of both sensors do not overlap: their clocks differ; use --time log"
    if common_s < settings.least_s:
        return f"both sensors share {common_s:.1f} s, at least {settings.least_s:g} s are needed: use a longer one"
    return f"every {settings.least_s:g} s have a gap of more than {stretches.longest_gap_s:g} s: see biodyn info"


def _undecided(reason: str) -> SensorCheck:
    return SensorCheck(Finding("not_decidable", reason))


def combined(found: Sequence[PairCheck]) -> Finding:
    """The finding of more than half of the decidable checks; clipping if any check shows it."""
    decidable = [one for one in found if one.verdict != "not_decidable"]
    if not decidable:
        return _common(found, 0)
    counts = Counter(_label(one) for one in decidable)
    label, most = counts.most_common(1)[0]
    if CLIPPED in counts:
        label = CLIPPED
    elif 2 * most <= len(decidable):
        shown = ", ".join(f"{name} in {count}" for name, count in counts.most_common())
        return Finding("unexplained", f"the stretches differ: {shown}", decidable=len(decidable))
    return _common([one for one in decidable if _label(one) == label], len(decidable))


def _label(one: PairCheck) -> str:
    """The fault of a check, or its verdict if it names none; both clock faults have one label."""
    if one.verdict not in NAMING:
        return one.verdict
    return CLOCKS[0] if one.name in CLOCKS else one.name


def _common(agreeing: Sequence[PairCheck], decidable: int) -> Finding:
    """The common finding of checks with one label."""
    name = Counter(one.name for one in agreeing).most_common(1)[0][0]
    same = [one for one in agreeing if one.name == name]
    others = tuple(sorted({n for one in agreeing for n in (one.name, *one.ambiguous_with)} - {name, ""}))
    return Finding(
        verdict="ambiguous" if others else same[0].verdict,
        reason=same[0].reason,
        name=name,
        ambiguous_with=others,
        size=_median([one.size for one in same]) if name else math.nan,
        lower=min(one.lower for one in same),
        upper=max(one.upper for one in same),
        unit=same[0].unit,
        agreeing=len(agreeing) if decidable else 0,
        decidable=decidable,
        background_percent=_median([one.background_percent for one in same]),
        before_percent=_median([one.before_percent for one in same]),
        after_percent=_median([one.after_percent for one in same]),
    )


def _median(values: Sequence[float]) -> float:
    """The median of the known values, NaN without any."""
    known = [value for value in values if not math.isnan(value)]
    return float(np.median(known)) if known else math.nan
