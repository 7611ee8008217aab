"""Origin of a subject's parameters: whom they describe, by the provenance in its file."""

from __future__ import annotations

from typing import Final, Literal

from biodyn_core.body.subject import EDITED, Subject

Origin = Literal["person", "group", "paper", "edited", "unknown"]
"""Fitted to recordings of this person; of published groups of people; printed in the paper; one of these and then
changed by hand; not stated."""

GROUP: Final = "population"
"""The key of the provenance of a subject of the population."""

PAPER: Final = "Zaman et al."


def origin_of(subject: Subject) -> Origin:
    """The origin of a subject's parameters."""
    stated = subject.provenance
    if stated.get(EDITED):
        return "edited"
    if stated.get("fitted"):
        return "person"
    if GROUP in stated:
        return "group"
    return "paper" if str(stated.get("source", "")).startswith(PAPER) else "unknown"
