"""The verdict on the seat for the replay page and the live page: tone, headline, reasons."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

from biodyn_core.base.segments import SEAT
from biodyn_core.base.wording import counted
from biodyn_ros.base.wording import HORIZONTAL, ZONE, sentence, time_left


@dataclass(frozen=True)
class Verdict:
    """The assessment of the seat: tone (good, warn, bad or none), headline, and the reasons, a sentence each."""

    tone: str
    headline: str
    reasons: tuple[str, ...]


_TONE: Final = {"below_action_value": "good", "above_action_value": "warn", "above_limit_value": "bad"}
"""All other zones have no colour."""


def seat_verdict(document: dict[str, Any], doubt: str = "") -> Verdict:
    """The pipeline's assessment of the seat against action and limit values.

    document: of `exposure.json`. doubt: a current fault of the seat; with it the verdict is never good, but a reached
    value remains reached.
    """
    seat, doubts = document["seat"], (sentence(doubt),) if doubt else ()
    if seat is None:
        return Verdict("none", "Undecided: nothing counted at the seat", doubts)
    tone, zone = _TONE.get(seat["zone"], "none"), seat["zone"]
    reasons = [sentence(seat["zone_reason"]), HORIZONTAL[seat["horizontal"]], *_bound_reasons(document)]
    if doubt:
        seat = seat | {"withheld": doubt}  # no time left is given
        if tone == "good":
            tone, zone, reasons = "none", "undecided", reasons[1:]
    times = [time_left(kind, seat) for kind in ("action", "limit")]
    return Verdict(tone, ZONE[zone], (*doubts, *reasons, *times))


def _bound_reasons(document: dict[str, Any]) -> list[str]:
    seat = document["sensors"].get(SEAT, {"lower_bound": False})
    if not seat["lower_bound"]:
        return []
    missing, clipped = seat["missing_s"], seat["clipped_samples"]
    return [f"Values are lower bounds: {missing:.3f} s missing and {counted(clipped, 'sample')} clipped at the seat."]
