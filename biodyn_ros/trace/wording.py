"""Sentences about a trace, the same for the page and the terminal."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Final

from biodyn_core.base.segments import SEAT, SEGMENTS
from biodyn_core.base.wording import counted, number_below, probability_text
from biodyn_core.effects import CATALOGUE, AppliedEffect
from biodyn_core.tracing.findings import (
    Diagnostics,
    Interval,
    RankedCandidate,
    RestoringForce,
    Round,
    SensorFinding,
    Trace,
)
from biodyn_core.tracing.probability import NONE, OUTSIDE
from biodyn_core.tracing.sensor_limits import LIMITS, within_limits
from biodyn_core.tracing.verdict import in_words
from biodyn_ros.base.json_files import finite
from biodyn_ros.base.wording import number, parameter_name, sentence, with_interval, without_unit, words
from biodyn_ros.reading.provenance import without_note
from biodyn_ros.trace.errors import WHEN, When, errors_by_use, known
from biodyn_ros.trace.report import Report

_RANKED: Final = 3
"""Number of channels or parameters in a ranking."""

_ANSWERS: Final = 5
"""Number of answers that are shown at least; trace.json has all."""

CALIBRATED: Final = {
    "anew": "computed for these recordings",
    "found": "read from an earlier trace of the same recordings",
    "not": "not computed",
}


def headline(trace: Trace) -> str:
    """The verdict in one sentence; without a verdict, the missing recordings."""
    before, after = _held_out(trace, "before"), _held_out(trace, "after")
    if trace.verdict == "effect":
        return _found(trace, before, after)
    if trace.verdict == "ambiguous":
        others = [one for one in trace.effects if trace.chosen is None or _key(one) != trace.chosen.key]
        beside = f" Also found: {_all(others)}." if others else ""
        return f"{_one_of(trace)}.{beside}"
    if trace.verdict == "none":
        others = ", ".join(in_words(one) for one in _not_excluded(trace))
        beside = f" Not excluded: {others}." if others else ""
        return f"No missing effect found.{beside} Held-out error {before} with refitted parameters."
    if trace.verdict == "unexplained":
        return f"The most probable answer is {in_words(OUTSIDE)}. Held-out error {after}."
    if not trace.needs:
        return f"These recordings have too little data for a verdict: {_first_reason(trace)}."
    return f"These recordings have too little data for a verdict. Record {trace.experiment}."


def _not_excluded(trace: Trace) -> list[str]:
    """The answers of the 90 % set beside `none`."""
    return [one for one in trace.rounds[0].likely if one != NONE] if trace.rounds else []


def _found(trace: Trace, before: str, after: str) -> str:
    others = _all(trace.not_added)
    if not trace.added:
        what = others or _best_in_words(trace)
        return f"Found: {what}. Nothing is added to the subject. Held-out error {before} with refitted parameters."
    main = f"Missing in the model: {_all(trace.added)}. With it, the held-out error goes from {before} to {after}."
    return f"{main} Also found, but not added: {others}." if others else main


def reliability(trace: Trace) -> str:
    """How reliable the verdict is."""
    if trace.verdict == "not_decidable":
        return "There is no verdict for or against any effect."
    limits = {
        "effect": "An effect outside the catalogue may have the same signature in these data.",
        "ambiguous": "Do not use the new subject as if the effect were known.",
        "none": "A smaller effect may be present.",
        "unexplained": "The cause is an effect or a site outside the catalogue, or the measurement: see the residual.",
    }
    return " ".join([*_probable(trace), *_named_bodies(trace), limits[trace.verdict]])


def chance(trace: Trace) -> str:
    """How often random draws reach the gain of the chosen candidate, or else the largest; empty if unknown."""
    p_value = known(trace.p_value)
    tried = [one for one in trace.rounds[0].ranking if finite(one.gain) is not None] if trace.rounds else []
    best = trace.chosen or max(tried, key=lambda one: (one.steady, one.gain), default=None)
    if p_value is None or best is None:
        return ""
    return (
        f"a residual with this spectrum and no missing effect reaches a gain of {number(finite(best.gain))}"
        f" ({effect_name(*best.key)}) in {_percent(p_value)} of random draws, which lack errors that repeat in every"
        f" event; the draws are {CALIBRATED[trace.calibrated]}"
    )


def probability(p: float, least: float = 0.0) -> str:
    """A probability with two decimals; never 0.00 or 1.00, which would exclude the rest.

    It has further decimals where two would show a probability below `least` as if it reached it.
    """
    if finite(p) is None:
        return number(None)
    shown = probability_text(p)
    return number_below(p, least) if shown[0].isdigit() and p < least <= float(shown) else shown


def answer_rows(found: Round) -> list[tuple[str, float, bool]]:
    """The most probable answers in words, their probabilities, and whether they are in the 90 % set.

    At least `_ANSWERS` of them, and the whole set.
    """
    shown = list(found.answers.items())[: max(_ANSWERS, len(found.likely))]
    return [(in_words(answer), p, answer in found.likely) for answer, p in shown]


def other_answers(found: Round) -> str:
    """The number of the answers that `answer_rows` omits, and their probability; empty without any."""
    omitted = list(found.answers.values())[len(answer_rows(found)) :]
    if not omitted:
        return ""
    together = " together" if len(omitted) > 1 else ""
    return f"{counted(len(omitted), 'further answer')}: {probability(sum(omitted))}{together}"


def subject_line(trace: Trace) -> str:
    """The content of subject.yaml."""
    if not trace.adds:
        return "subject.yaml: equals the given subject, because no effect was added"
    return f"subject.yaml: the refitted subject with {_all(trace.added)}"


def sensor_lines(trace: Trace) -> list[str]:
    """The findings about sensors, a line each."""
    return [_sensor_line(found) for found in trace.sensors]


TONE: Final = {"effect": "good", "ambiguous": "warn", "none": "good", "unexplained": "bad", "not_decidable": "none"}


def tone(report: Report) -> str:
    """The colour of the verdict: green needs measured recordings and no other answer beside `none`.

    An effect has to improve held-out events.
    """
    trace, (by_model, _) = report.trace, without_note(report.warnings)
    if TONE[trace.verdict] == "good" and by_model:
        return "none"
    is_unsure = (trace.verdict == "effect" and not _improves(trace)) or (
        trace.verdict == "none" and bool(_not_excluded(trace))
    )
    return "warn" if is_unsure else TONE[trace.verdict]


def effect_name(name: str, site: str) -> str:
    """`stop`, `pelvis` is "stop in the joint between seat and pelvis"."""
    return f"{words(name)} {_place(name, site)}"


def force_place(found: RestoringForce) -> str:
    """The place of a missing force with its effects: "stop in the joint between seat and pelvis"."""
    if found.effects:
        return grouped(found.effects, " and ")[0]
    return _joint(found.site)


def grouped(effects: Sequence[AppliedEffect], joined: str = " or ") -> list[str]:
    """Effects by name, those of one place together: "stop or cubic in the joint between seat and pelvis"."""
    by_place: dict[str, list[str]] = {}
    for one in effects:
        by_place.setdefault(_place(*_key(one)), []).append(words(one.effect.name))
    return [f"{joined.join(names)} {place}" for place, names in by_place.items()]


def short_name(one: RankedCandidate) -> str:
    """An effect and its site where space is short: "stop, pelvis"."""
    return ", ".join(map(words, one.key))


def parameters_of(applied: AppliedEffect, intervals: Sequence[Interval] = ()) -> list[tuple[str, str]]:
    """Each parameter that is not neutral as text: its name without unit, its value with interval and unit."""
    by_name = {each.name: each for each in intervals}
    shown = []
    stated = applied.stated_values
    for parameter in (one for one in applied.effect.parameters if one.name in stated):
        interval, value = by_name.get(parameter.name), number(applied.values[parameter.name])
        if interval is not None:
            value, lower, upper = with_interval(*map(finite, (interval.value, interval.lower, interval.upper)))
            value = f"{value} ({lower} to {upper})"
        unit = "" if parameter.unit in ("", "-") else f" {parameter.unit}"
        shown.append((without_unit(parameter.name), value + unit))
    return shown


def diagnostic_lines(found: Diagnostics | None) -> list[str]:
    """The diagnostics, a sentence each."""
    if found is None:
        return []
    parts = (_transfer, _coherent, _peeled, _level, _jump, _seat, _theta)
    return [sentence(line) for part in parts for line in part(found)]


_FAULT_TEXT: Final = {
    "tilt": "has a mean tilt of {size} in motion",
    "gain": "may have a gain error of {size}",
    "clock": "may have a clock offset of {size}",
}
_SHOWN: Final = {"tilt": (180.0 / math.pi, "deg"), "gain": (100.0, "%"), "clock": (1e3, "ms")}
"""By effect: the factor from the unit of its limit, and the unit that is shown."""


def _sensor_line(found: SensorFinding) -> str:
    name, (scale, unit) = found.fault.effect.name, _SHOWN[found.fault.effect.name]
    size, limit = LIMITS[name].size(found.fault.values), LIMITS[name].limit
    what = _FAULT_TEXT[name].format(size=f"{number(scale * abs(size))} {unit}")
    source = "by its gyro, which the recording corrects" if found.source == "gyro" else "by the fit"
    allowed = f"{'within' if within_limits(found.fault) else 'beyond'} the limit of {number(scale * abs(limit))} {unit}"
    gain = "" if found.gain is None else f" (gain {number(known(found.gain))})"
    cause = f"it is {'the' if found.explains else 'not the'} named cause{gain}"
    return f"the sensor on the {words(found.fault.site)} {what}, {source}; {allowed}; {cause}"


def _held_out(trace: Trace, when: When) -> str:
    """The error over all held-out events; without any, that over the events for fitting."""
    errors = errors_by_use(trace, when)
    held_out, fitted = errors["held_out"]["all"], errors["train"]["all"]
    if held_out is not None:
        return f"{number(held_out)} %"
    return "not known" if fitted is None else f"not known ({number(fitted)} % where it was fitted)"


def _improves(trace: Trace) -> bool:
    """Whether the added effects improve held-out events; True if none is added."""
    if not trace.added:
        return True
    before, after = (errors_by_use(trace, when)["held_out"]["all"] for when in WHEN)
    return before is not None and after is not None and after < before


def _key(one: AppliedEffect) -> tuple[str, str]:
    return one.effect.name, one.site


def _all(effects: Sequence[AppliedEffect]) -> str:
    return ", and ".join(grouped(effects, " and "))


def _one_of(trace: Trace) -> str:
    """The possible answers of an ambiguous trace; `nothing visible is missing` may be one of them."""
    likely = trace.rounds[0].likely if trace.rounds else ()
    effects = [*([trace.chosen.applied] if trace.chosen else trace.effects), *trace.ambiguous_with]
    named = grouped(effects) or [_best_in_words(trace)]
    outside = [in_words(OUTSIDE)] if OUTSIDE in likely else []
    missing = f"An effect {'may be' if NONE in likely else 'is'} missing"
    how = "one of these:" if len(effects) + len(outside) > 1 else "most probably"
    return f"{missing}, {how} {', or '.join([*named, *outside])}"


def _best_in_words(trace: Trace) -> str:
    return in_words(trace.rounds[0].best) if trace.rounds else trace.family or "an effect"


def _place(name: str, site: str) -> str:
    place = CATALOGUE[name].place
    if place == "joint":
        return f"in the {_joint(site)}"
    if place == "sensor":
        return f"of the sensor on the {words(site)}"
    return "of the seat" if place == "seat" else f"on the {words(site)}"


def _joint(site: str) -> str:
    below = (SEAT, *SEGMENTS)[SEGMENTS.index(site)]
    return f"joint between {words(below)} and {words(site)}"


def _first_reason(trace: Trace) -> str:
    """The first reason without a full stop."""
    lines = [*trace.lacking, *trace.reasons]
    return lines[0].rstrip(".") if lines else "they are too short"


def _probable(trace: Trace) -> Iterator[str]:
    """The probability of the verdict's answer, a sentence each."""
    if not trace.rounds:
        return
    best, chosen = trace.rounds[0].best, trace.chosen
    least = trace.named_from or 0.0
    shown = probability(trace.rounds[0].answers[best], least)
    if best == NONE:
        yield f"The probability that {in_words(best)} is {shown}."
    elif best == OUTSIDE:
        yield f"The probability of {in_words(best)} is {shown}."
    else:
        site = f", that of {effect_name(*chosen.key)} is {probability(chosen.probability, least)}" if chosen else ""
        yield f"The probability of the mechanism {in_words(best)} is {shown}{site}."


def _named_bodies(trace: Trace) -> Iterator[str]:
    """How often effects of several sizes were named in simulation."""
    if trace.named_bodies:
        first, *others = trace.named_bodies
        counts = [f"{first.named} of {first.bodies} bodies with a ratio of {first.ratio:g}"]
        counts += [f"{one.named} of {one.bodies} with {one.ratio:g}" for one in others]
        yield f"In simulation an effect was named in {', in '.join(counts)}."


REASONED: Final = "by reasoning from the laws of these effects, not tried in simulation"


def record_next(trace: Trace) -> list[str]:
    """The recordings that separate causes, and what more of the same shows in simulation; empty without a verdict."""
    separating = [f"{trace.experiment} ({REASONED})"] if trace.experiment and not trace.needs else []
    return [*separating, *_louder(trace), *_further(trace)]


def _louder(trace: Trace) -> Iterator[str]:
    """What louder motion lifts, of the possible mechanisms, in one sentence."""
    if trace.louder:
        each = ", ".join(
            f"{one.with_true_law_louder} instead of {one.with_true_law} of {one.effects} effects with"
            f" {in_words(one.mechanism)}"
            for one in trace.louder
        )
        now, then = (sum(getattr(one, name) for one in trace.louder) for name in ("named", "named_louder"))
        yield (
            f"the same drives with {trace.louder[0].level:g} times the motion: in simulation a decision that knows the"
            f" true laws then names {each}, and the learned model {then} instead of {now} of these"
        )


def _further(trace: Trace) -> Iterator[str]:
    """The causes named in simulation from the least data, and from more, in one sentence."""
    if not trace.further:
        return
    least, *more = trace.further
    each = ", ".join(f"{one.recordings}: {one.named}" for one in more)
    causes = counted(least.named, "right cause is", "right causes are")
    yield (
        f"in simulation of {least.bodies} bodies with one missing effect, {causes} named from"
        f" {least.recordings}, for fitting and again held out. With further recordings for both: {each}"
    )


def _percent(share: float) -> str:
    """A share in percent with two significant digits."""
    return f"{float(f'{100.0 * share:.2g}'):g} %"


# --- diagnostics -----------------------------------------------------------------------------------------------------


def _transfer(found: Diagnostics) -> Iterator[str]:
    shown = ", ".join(
        f"{case} {number(finite(alone))} ({number(finite(together))})"
        for case, (alone, together) in found.amplitude_transfer.items()
    )
    if shown:
        yield (
            "residual with parameters fitted to the quietest condition alone, in multiples of a good model's:"
            f" {shown}; in brackets, fitted to all conditions. A much larger residual in louder conditions means that"
            " the missing effect depends on amplitude"
        )


def _coherent(found: Diagnostics) -> Iterator[str]:
    shares = {channel: of for channel, of in found.coherent.items() if finite(of[1]) is not None}
    ranked = sorted(shares.items(), key=lambda item: -item[1][1])[:_RANKED]
    shown = ", ".join(f"{channel} {100 * share:.0f} % ({words(segment)})" for channel, (segment, share) in ranked)
    if shown:
        yield f"share of the residual's power that is coherent with a channel, above chance: {shown}"


def _peeled(found: Diagnostics) -> Iterator[str]:
    shown = ", ".join(f"{words(node)} {number(finite(percent))} %" for node, percent in found.peeling.items())
    where = ", ".join(map(words, found.bracket))
    if shown:
        fault = f"the fault then lies in the joint below {where}" if where else "no joint is conspicuous"
        yield f"error of the body above each sensor, driven by that sensor's measurement: {shown}; {fault}"


def _level(found: Diagnostics) -> Iterator[str]:
    slope = known(found.level_slope)
    if slope is not None:
        how = "in proportion to" if abs(slope) < 0.15 else "faster than" if slope > 0.0 else "slower than"
        line = f"from event to event the residual grows {how} the peak"
        yield f"{line} (slope of the relative residual {slope:.2f}; 0 is a linear effect)"


def _jump(found: Diagnostics) -> Iterator[str]:
    if found.jump is not None and finite(found.jump[1]) is not None:
        event, p_value = found.jump
        line = f"in the order of time the residual changes most at {event}"
        yield f"{line}; by chance such a change occurs in {_percent(p_value)} of shuffled orders"


def _seat(found: Diagnostics) -> Iterator[str]:
    share = finite(found.seat_tension)
    if share is not None and share > 0.0:
        beyond = "more than the weight: a seat carries no tension, so the body must lift off"
        limit = beyond if share > 1.0 else "less than the weight, so the body does not lift off"
        yield f"the largest tension between seat and body is {number(share)} times the weight above it, {limit}"


def _theta(found: Diagnostics) -> Iterator[str]:
    if found.at_bound:
        yield f"on a bound of Table 1: {', '.join(map(parameter_name, found.at_bound))}"
    spreads = {name: spread for name, spread in found.drift.items() if finite(spread) is not None}
    ranked = sorted(spreads.items(), key=lambda item: -item[1])[:_RANKED]
    if ranked:
        shown = ", ".join(f"{parameter_name(name)} {number(spread)}" for name, spread in ranked)
        yield f"largest drift between fits of single conditions (ln of largest over smallest): {shown}"
