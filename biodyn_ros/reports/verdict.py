"""The assessment of the seat in words, for terminal, pages and live page: zone, time left, shocks, verdict."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

from biodyn_core.base.wording import number
from biodyn_core.exposure.limit_assessment import LimitAssessment, SeatExposure
from biodyn_core.exposure.limits import KINDS, Kind
from biodyn_core.exposure.losses import Losses
from biodyn_ros.base.wording import duration, losses_text, sentence, words

ZONE: Final = {
    "below_action_value": "Below the action values so far",
    "above_action_value": "Action value reached",
    "above_limit_value": "Limit value reached",
    "undecided": "Undecided: no assessment of the seat",
}
HORIZONTAL: Final = {
    "yaw_given": "Horizontal axes from the yaw given.",
    "worst_direction": "No yaw given: the largest value over all horizontal directions is used for both axes.",
    "missing": "Vertical only: horizontal data are missing.",
}
_RATIO: Final = {"crest_factor": "crest factor", "mtvv_over_aw": "MTVV/aw", "vdv_over_aw_t": "VDV/(aw T^1/4)"}
_TONE: Final = {"below_action_value": "good", "above_action_value": "warn", "above_limit_value": "bad"}
"""All other zones have no colour."""


@dataclass(frozen=True)
class Verdict:
    """The assessment of the seat: tone (good, warn, bad or none), headline, and the reasons, a sentence each."""

    tone: str
    headline: str
    reasons: tuple[str, ...]


def seat_verdict(seat: SeatExposure | None, losses: Losses | None, doubt: str = "") -> Verdict:
    """The pipeline's assessment of the seat against action and limit values; losses: of the seat, if it has counted.

    doubt: a current fault of the seat; with it the verdict is never good, but a reached value remains reached.
    """
    doubts = (sentence(doubt),) if doubt else ()
    if seat is None:
        return Verdict("none", "Undecided: nothing counted at the seat", doubts)
    tone, headline = _TONE.get(seat.zone, "none"), zone_text(seat)
    if seat.may_be_reached and tone == "none":
        tone = "warn"
    reasons = [sentence(seat.zone_reason), HORIZONTAL[seat.horizontal]]
    if losses and losses.lower_bound:
        reasons.append(f"Values are lower bounds: at the seat {losses_text(losses)}.")
    if doubt:
        seat = replace(seat, withheld=doubt)  # no time left is given
        if tone == "good":
            tone, headline, reasons = "none", ZONE["undecided"], reasons[1:]
    return Verdict(tone, headline, (*doubts, *reasons, *(time_left(kind, seat) for kind in KINDS)))


def zone_text(assessed: LimitAssessment) -> str:
    """The zone, and the value that may be reached while it is undecided."""
    if assessed.zone == "undecided" and assessed.may_be_reached:
        return f"Undecided: the {assessed.may_be_reached} value may be reached"
    return ZONE[assessed.zone]


def left(kind: Kind, seat: SeatExposure) -> str:
    """The time left to the action or limit value, in a few words."""
    if seat.zone in ("above_limit_value", f"above_{kind}_value"):  # a lower bound suffices for this
        return "reached"
    if seat.withheld:
        return "withheld"
    seconds = _seconds_left(kind, seat)
    if seconds is None:
        return "never reached at this rate"
    if seat.is_estimate:  # too high or too low, and missing samples lower it
        return f"about {duration(seconds)} left"
    return f"at most {duration(seconds, at_most=True)} left" if seat.lower_bound else f"{duration(seconds)} left"


def time_left(kind: Kind, seat: SeatExposure) -> str:
    """The time left to the action or limit value, as a sentence."""
    name, phrase = f"{kind.capitalize()} value", left(kind, seat)
    if phrase == "withheld":
        return f"{name}: time left withheld, because {seat.withheld}."
    if _seconds_left(kind, seat) is None or phrase == "reached":
        return f"{name}: {phrase}."
    return f"{name}: {phrase}, if exposure continues at this rate."


def _seconds_left(kind: Kind, seat: SeatExposure) -> float | None:
    return seat.time_to_action_value_s if kind == "action" else seat.time_to_limit_value_s


def shocks(seat: SeatExposure) -> str:
    """Whether ISO 2631-1 requires more than the rms on the governing axis."""
    where = f"ISO 2631-1:1997, axis {words(seat.axis)}"
    firing = [
        f"{_RATIO[ratio.name]} {number(ratio.value)} > {ratio.threshold:g} ({ratio.clause})"
        for ratio in seat.shock_ratios
        if ratio.exceeded
    ]
    if firing:
        return f"Shocks: additional evaluation required ({where}): {', '.join(firing)}."
    unknown = [_RATIO[ratio.name] for ratio in seat.shock_ratios if ratio.exceeded is None]
    if seat.lower_bound or unknown:
        cause = "uncertain by the seconds left out" if seat.suspect_s > 0.0 else "not measured"
        why = f"{' and '.join(unknown)} {cause}" if unknown else "the seat's values are lower bounds"
        return f"Shocks: undecided whether additional evaluation is required ({where}): {why}."
    known = ", ".join(f"{_RATIO[ratio.name]} {number(ratio.value)}" for ratio in seat.shock_ratios)
    return f"Shocks: no additional evaluation required ({where}): {known}."
