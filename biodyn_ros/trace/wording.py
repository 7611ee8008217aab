"""What a trace says in plain sentences, from the mapping of trace.json; the page and the terminal say the same."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Any, Final

from biodyn_core.base.segments import SEAT, SEGMENTS
from biodyn_core.effects import CATALOGUE, EffectParameter
from biodyn_ros.base.wording import number, parameter_name, sentence, with_interval, words
from biodyn_ros.reading.provenance import without_note

Document = dict[str, Any]

_UNIT: Final = re.compile(r"(_n|_m|_s)?_(per_m2|per_m|per_n|s_per_m|mps2|mps|hz|kg|m|s|n)$")
"""What a parameter's name ends in to say its unit."""

CALIBRATED: Final = {
    "anew": "computed anew for these recordings",
    "found": "taken from an earlier trace of the same recordings",
    "not": "not calibrated",
}


def headline(document: Document) -> str:
    """The verdict in one sentence, and what to record where there is none."""
    before, after = (_held_out(document, when) for when in ("before", "after"))
    verdict = document["verdict"]
    if verdict == "effect":
        added, beside = ([each for each in document["effects"] if each["added"] is way] for way in (True, False))
        if not added:
            what = _all(beside) or "an effect"
            return f"Found: {what}. It is nothing that a subject can carry, so none was added. Held-out error {before}."
        said = f"Missing in the model: {_all(added)}. Added, it takes the held-out error from {before} to {after}."
        return f"{said} Found beside, and not added: {_all(beside)}." if beside else said
    if verdict == "ambiguous":
        said = f"Something is missing, and it cannot be told which: {_either(document)}."
        beside = [each for each in document["effects"] if not _is(each, _taken(document))]
        return f"{said} Found beside: {_all(beside)}." if beside else said
    if verdict == "none":
        said = "nothing that was tried gains more than was asked, or than is usual in bodies and sensors"
        return f"No missing effect found: {said}. Held-out error {before}."
    if verdict == "unexplained":
        return f"Something is missing, and no effect that was tried explains it. Held-out error {after}."
    if not document["to_record"]:
        return f"These recordings cannot decide what is missing: {_first(document)}."
    return f"These recordings cannot decide what is missing. Record {document['separating_experiment']}."


def belief(document: Document) -> str:
    """Whether to believe the verdict, and as far as what."""
    verdict, chance = document["verdict"], _chance(document)
    if verdict == "effect" and not any(effect["added"] for effect in document["effects"]):
        return (
            "Believe it as far as the measurement: a lean is what the sensor's own gyro says, a line or a posture what"
            " the events that choose show. No number of the body was changed for it."
        )
    if verdict == "effect":
        return (
            f"Believe it as far as this: {chance}. Another effect with the same mark on these data, one that was not"
            " tried, would look no different."
        )
    if verdict == "ambiguous":
        return (
            f"Believe that something is missing, not what: {chance}. Do not use the new subject as if the effect were"
            " known."
        )
    if verdict == "none":
        return f"Believe that nothing of the sizes tried shows here, not that nothing is there: {chance}."
    if verdict == "unexplained":
        return (
            "Believe that the model falls short, and look at the residual: what is missing is of a kind or at a place"
            " that was not tried, or it is the measurement."
        )
    return "No verdict, neither for nor against any effect."


def subject_said(document: Document) -> str:
    """What subject.yaml holds."""
    if document["subject_written"] == "as_given":
        return "subject.yaml: equals the given subject, because no effect was added"
    added = [each for each in document["effects"] if each["added"]]
    return f"subject.yaml: the refitted subject with {_all(added)}"


def sensors_said(document: Document) -> list[str]:
    """The findings about sensors, a line each, and whether each explains what is left."""
    return [_sensor_said(found) for found in document["sensors"]]


def tone(document: Document) -> str:
    """The colour of the verdict; green for nothing that the model itself made, nor an effect that helps nowhere."""
    found, (made, _) = TONE[document["verdict"]], without_note(document.get("warnings", []))
    if found == "good" and made:
        return "none"
    return "warn" if document["verdict"] == "effect" and not _helps(document) else found


TONE: Final = {"effect": "good", "ambiguous": "warn", "none": "good", "unexplained": "bad", "not_decidable": "none"}


def effect_name(name: str, site: str) -> str:
    """`stop`, `pelvis` is "stop in the joint between seat and pelvis"."""
    return f"{words(name)} {_place(name, site)}"


def grouped(effects: Sequence[Document], joined: str = " or ") -> list[str]:
    """Effects by name, those of one place together: "stop or cubic in the joint between seat and pelvis"."""
    by_place: dict[str, list[str]] = {}
    for each in effects:
        by_place.setdefault(_place(each["name"], each["site"]), []).append(words(each["name"]))
    return [f"{joined.join(names)} {place}" for place, names in by_place.items()]


def short_name(each: Document) -> str:
    """The same where room is short: "stop, pelvis"."""
    return f"{words(each['name'])}, {words(each['site'])}"


def with_unit(value: float | None, unit: str) -> str:
    """A number with its unit, where it has one."""
    return f"{number(value)} {unit}" if unit not in ("", "-") else number(value)


def interval(of: Document) -> str:
    """A value with its 95 % interval and unit."""
    value, lower, upper = with_interval(of["value"], of["lower"], of["upper"])
    return f"{value} ({lower} to {upper})" + ("" if of["unit"] in ("", "-") else f" {of['unit']}")


def parameters_of(effect: Document) -> list[tuple[str, str]]:
    """Each parameter of an effect as it is shown: its name without unit, its value with interval and unit."""
    shown = []
    for parameter in CATALOGUE[effect["name"]].parameters:
        of = effect["intervals"].get(parameter.name)
        value = effect["parameters"][parameter.name]
        shown.append((_without_unit(parameter), interval(of) if of else with_unit(value, parameter.unit)))
    return shown


def diagnosed(found: Document) -> list[str]:
    """The diagnostics, a sentence each; none where there are none."""
    if not found:
        return []
    lines = [*_transfer(found), *_coherent(found), *_peeled(found), *_level(found), *_jump(found), *_seat(found)]
    return [sentence(line) for line in (*lines, *_theta(found))]


def _sensor_said(found: Document) -> str:
    scale, unit = _SHOWN[found["name"]]
    size, limit = (number(scale * abs(found[key])) for key in ("size", "limit"))
    how = _SAID[found["name"]].format(size=f"{size} {unit}")
    by = "as its gyro has it; recordings set it upright" if found["told_by"] == "gyro" else "as the fit has it"
    allowed = f"{'within' if found['within_limit'] else 'beyond'} the {limit} {unit} allowed to a sensor"
    gained = "" if found["gain"] is None else f" (gain {number(found['gain'])})"
    explains = f"it {'explains' if found['explains'] else 'does not explain'} the residual{gained}"
    return f"the sensor on the {words(found['site'])} {how}, {by}; {allowed}; {explains}"


_SAID: Final = {
    "tilt": "leans by {size} on the mean while it moves",
    "gain": "is off by {size} in its gain",
    "clock": "is off by {size} in its clock",
}
_SHOWN: Final = {"tilt": (180.0 / math.pi, "deg"), "gain": (100.0, "%"), "clock": (1e3, "ms")}
"""By effect: the factor from the document's unit, and the unit that is shown."""


def _without_unit(parameter: EffectParameter) -> str:
    """`gap_m` is "gap": the unit stands behind the value."""
    name = _UNIT.sub("", parameter.name) if parameter.unit else parameter.name
    return words(name)


def _held_out(document: Document, when: str) -> str:
    """The error over all held-out events, or of those that were fitted to, said so."""
    errors = document["error"][when]
    if errors["held_out"]["all"] is not None:
        return f"{number(errors['held_out']['all'])} %"
    known = errors["train"]["all"]
    return "not known" if known is None else f"not known ({number(known)} % where it was fitted)"


def _helps(document: Document) -> bool:
    """Whether the events that had no say are predicted better with what was added, or nothing was."""
    if not any(each["added"] for each in document["effects"]):
        return True
    before, after = (document["error"][when]["held_out"]["all"] for when in ("before", "after"))
    return before is not None and after is not None and after < before


def _all(effects: Sequence[Document]) -> str:
    return ", and ".join(grouped(effects, " and "))


def _either(document: Document) -> str:
    taken = _taken(document)
    rivals = grouped([*([taken] if taken else document["effects"]), *document["ambiguous_with"]])
    return ", or ".join(rivals) or document["family"] or "no name"


def _taken(document: Document) -> Document | None:
    """What the first round took."""
    return document["rounds"][0]["taken"] if document["rounds"] else None


def _is(one: Document, other: Document | None) -> bool:
    return other is not None and (one["name"], one["site"]) == (other["name"], other["site"])


def _place(name: str, site: str) -> str:
    place = CATALOGUE[name].place
    if place == "joint":
        below = (SEAT, *SEGMENTS)[SEGMENTS.index(site)]
        return f"in the joint between {words(below)} and {words(site)}"
    if place == "sensor":
        return f"of the sensor on the {words(site)}"
    return "of the seat" if place == "seat" else f"on the {words(site)}"


def _first(document: Document) -> str:
    """What is lacking first, without the full stop that the sentence brings."""
    lines = [*document["lacking"], *document["reasons"]]
    return lines[0].rstrip(".") if lines else "they hold too little"


def _chance(document: Document) -> str:
    p_value, threshold = document["p_value"], document["threshold"]
    if p_value is None or threshold is None:
        return "how often chance does as much is not known"
    taken, tried = _taken(document), document["candidates"]
    best = next((e for e in tried if (_is(e, taken) if taken else e["refitted"] and e["steady"])), None)
    reached = f", {effect_name(best['name'], best['site'])} reached {number(best['gain'])}" if best else ""
    often = f"a residual of these colours without a cause does as well {100.0 * p_value:.2g} % of the time"
    blind = "that knows no misfit that is alike in every event, for which"
    return f"{often}; {blind} a gain had to exceed {number(threshold)} ({CALIBRATED[document['calibrated']]}){reached}"


# --- diagnostics -----------------------------------------------------------------------------------------------------


def _transfer(found: Document) -> list[str]:
    cases = found["amplitude_transfer"]
    if not cases:
        return []
    shown = ", ".join(f"{case} {number(of['quietest_alone'])} ({number(of['all'])})" for case, of in cases.items())
    line = (
        "fitted to the quietest condition alone, the residual is, in multiples of what a good model misses,"
        f" {shown}; in brackets, fitted to all"
    )
    return [f"{line}. Much more in louder ones means that what is missing depends on amplitude"]


def _coherent(found: Document) -> list[str]:
    known = {channel: of for channel, of in found["coherent"].items() if of["share"] is not None}
    if not known:
        return []
    ranked = sorted(known.items(), key=lambda item: -item[1]["share"])[:3]
    shown = ", ".join(f"{channel} {100 * of['share']:.0f} % ({words(of['segment'])})" for channel, of in ranked)
    return [f"share of the residual's power that goes linearly with a channel, chance taken off: {shown}"]


def _peeled(found: Document) -> list[str]:
    chains = found["peeling"]
    if not chains:
        return []
    shown = ", ".join(f"{words(node)} {number(percent)} %" for node, percent in chains.items())
    where = ", ".join(words(name) for name in found["bracket"])
    line = f"the body above each sensor, driven by what that sensor measured, leaves: {shown}"
    return [f"{line}; the fault then lies in the joint below {where}" if where else f"{line}; none stands out"]


def _level(found: Document) -> list[str]:
    slope = found["level_slope"]
    if slope is None:
        return []
    how = "in proportion to" if abs(slope) < 0.15 else "faster than" if slope > 0.0 else "slower than"
    line = f"from event to event the residual grows {how} the peak"
    return [f"{line} (slope of the relative residual {slope:.2f}; 0 is a linear effect)"]


def _jump(found: Document) -> list[str]:
    jump = found["jump"]
    if jump is None or jump["p_value"] is None:
        return []
    chance = f"chance does as much {100 * jump['p_value']:.2g} % of the time"
    return [f"in the order given the residual changes most at {jump['event']}; {chance}"]


def _seat(found: Document) -> list[str]:
    share = found["pulled_down"]
    if share is None or share <= 0.0:
        return []
    beyond = "more than its weight, which no seat can: it must lift off" if share > 1.0 else "less than its weight"
    return [f"the seat would have to hold the body down by up to {number(share)} times what it carries, {beyond}"]


def _theta(found: Document) -> list[str]:
    lines = []
    if found["pinned"]:
        lines.append(f"on a bound of Table 1: {', '.join(parameter_name(name) for name in found['pinned'])}")
    apart = {name: spread for name, spread in found["drift"].items() if spread is not None}
    if apart:
        ranked = sorted(apart.items(), key=lambda item: -item[1])[:3]
        shown = ", ".join(f"{parameter_name(name)} {number(spread)}" for name, spread in ranked)
        lines.append(f"largest drift between fits of single conditions (ln of largest over smallest): {shown}")
    return lines
