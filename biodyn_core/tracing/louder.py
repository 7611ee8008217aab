"""Louder recordings: what more motion lifts in simulation, by mechanism, as `python -m blind levels` has stored it."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping
from functools import cache
from importlib import resources
from typing import Any, Final

from biodyn_core.tracing.findings import LouderRecordings

FILE: Final = "louder.json"
_COUNTS: Final = ("effects", "named", "named_louder", "with_true_law", "with_true_law_louder")


def louder_recordings(mechanisms: Collection[str]) -> tuple[LouderRecordings, ...]:
    """Those of these mechanisms of which louder motion lets more effects be named."""
    return tuple(one for one in _stored() if one.mechanism in mechanisms and one.lifts)


@cache
def _stored() -> tuple[LouderRecordings, ...]:
    return louder_from(resources.files("biodyn_core.tracing").joinpath(FILE).read_text(encoding="utf-8"))


def louder_from(text: str) -> tuple[LouderRecordings, ...]:
    """The recordings of a text of `louder_text`."""
    stored = json.loads(text)
    return tuple(LouderRecordings(name, stored["level"], **counts) for name, counts in stored["mechanisms"].items())


def louder_text(found: Collection[LouderRecordings], level: float, provenance: Mapping[str, Any]) -> str:
    """The text of recordings at one level, with their provenance."""
    mechanisms = {one.mechanism: {name: getattr(one, name) for name in _COUNTS} for one in found}
    return json.dumps({"provenance": provenance, "level": level, "mechanisms": mechanisms}, indent=1) + "\n"
