"""The verdict on the seat as a reader sees it, on the page of a replay and on the live one: tone, headline, reasons."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

from biodyn_core.base.segments import SEAT
from biodyn_core.base.wording import counted
from biodyn_ros.base.wording import HORIZONTAL, ZONE, sentence, time_left


@dataclass(frozen=True)
class Verdict:
    """The seat against its limits: tone (good, warn, bad or none), headline, and the reasons, a sentence each."""

    tone: str
    headline: str
    reasons: tuple[str, ...]


_TONE: Final = {"below_action_value": "good", "above_action_value": "warn", "above_limit_value": "bad"}
"""No colour of judgement for anything else, and green for nothing but the first."""


def judge(document: dict[str, Any], doubt: str = "") -> Verdict:
    """Say how the seat stands against action and limit values, as the pipeline has judged it.

    document: of `exposure.json`. doubt: what else is wrong with the seat now; with it nothing is called good, while a
    value that is reached remains so.
    """
    seat, doubts = document["seat"], (sentence(doubt),) if doubt else ()
    if seat is None:
        return Verdict("none", "Undecided: nothing counted at the seat", doubts)
    tone, zone = _TONE.get(seat["zone"], "none"), seat["zone"]
    reasons = [sentence(seat["zone_reason"]), HORIZONTAL[seat["horizontal"]], *_bound_reasons(document)]
    if doubt:
        seat = seat | {"withheld": doubt}  # nobody is promised time
        if tone == "good":
            tone, zone, reasons = "none", "undecided", reasons[1:]
    times = [time_left(kind, seat) for kind in ("action", "limit")]
    return Verdict(tone, ZONE[zone], (*doubts, *reasons, *times))


def _bound_reasons(document: dict[str, Any]) -> list[str]:
    seat = document["sensors"].get(SEAT, {"lower_bound": False})
    if not seat["lower_bound"]:
        return []
    missing, clipped = seat["missing_s"], seat["clipped_samples"]
    return [f"At least so much: {missing:.3f} s missing and {counted(clipped, 'sample')} clipped at the seat."]
