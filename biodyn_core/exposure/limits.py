"""Limits: action and limit values by their source, and the file that holds them."""

from __future__ import annotations

import dataclasses
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

from biodyn_core.base.errors import InputError
from biodyn_core.base.suggestions import did_you_mean
from biodyn_core.base.yaml_files import read_yaml

Measure = Literal["a8", "vdv"]
Kind = Literal["action", "limit"]
KINDS: Final[tuple[Kind, Kind]] = ("action", "limit")


@dataclass(frozen=True)
class LimitSet:
    """Action and limit values of one source, A(8) m/s^2 and VDV m/s^1.75; None where the source states none."""

    source: str
    action_a8_mps2: float | None
    action_vdv_mps175: float | None
    limit_a8_mps2: float | None
    limit_vdv_mps175: float | None

    def to_dict(self) -> dict[str, Any]:
        """Return the values by name."""
        return dict(self.__dict__)

    def values(self, kind: Kind) -> dict[Measure, float]:
        """The action or the limit values that are stated."""
        a8, vdv = (
            (self.action_a8_mps2, self.action_vdv_mps175)
            if kind == "action"
            else (self.limit_a8_mps2, self.limit_vdv_mps175)
        )
        stated: dict[Measure, float | None] = {"a8": a8, "vdv": vdv}
        return {measure: value for measure, value in stated.items() if value is not None}


@dataclass(frozen=True)
class Limits:
    """The set of limits that decides, and additional sets that are shown with it."""

    deciding: LimitSet
    additional: tuple[LimitSet, ...] = ()


EU_LIMITS: Final = Limits(
    deciding=LimitSet("2002/44/EC", 0.5, 9.1, 1.15, 21.0),
    additional=(LimitSet("ISO 2631-1 caution zone", None, 8.5, None, 17.0),),
)
"""The directive decides; the additional set is the VDV pair of Zaman et al., 4.6, which has no A(8)."""


def load_limits(path: str | Path) -> Limits:
    """Read a limits file: one set by itself, or `sets` and which of them `decides`.

    Raises InputError naming the file, the set and the key.
    """
    data = read_yaml(path)
    try:
        return _limits(data)
    except (InputError, RecursionError) as error:
        raise InputError(f"{path}: {error}") from error


def _limits(data: object) -> Limits:
    if not isinstance(data, dict) or not {"sets", "decides"} & set(data):
        return Limits(_limit_set(data, ""))
    if set(data) != {"sets", "decides"} or not isinstance(data["sets"], list) or not data["sets"]:
        keys = {"sets", "decides"}
        odd = ", ".join(sorted(map(str, set(data) ^ keys))) or "sets is not a list, or is empty"
        near = next((text for key in sorted(map(str, set(data) - keys)) if (text := did_you_mean(key, keys))), "")
        raise InputError(
            f"a list of sets and the source that decides are needed; missing, unknown or wrong: {odd}{near}"
        )
    sets = [_limit_set(item, f"sets[{index}]: ") for index, item in enumerate(data["sets"])]
    sources = [each.source for each in sets]
    for source in sources:
        if sources.count(source) > 1:
            raise InputError(f"sets: {source!r} is there twice, every set needs its own source")
    if data["decides"] not in sources:
        near = did_you_mean(data["decides"], sources)
        allowed = ", ".join(sources)
        raise InputError(f"decides is {data['decides']!r}, allowed are the sources of the sets: {allowed}{near}")
    decides = sources.index(data["decides"])
    return Limits(sets[decides], tuple(sets[:decides] + sets[decides + 1 :]))


def _limit_set(data: object, where: str) -> LimitSet:
    """One set: its source, and action and limit value of A(8), of VDV or of both."""
    names = [item.name for item in dataclasses.fields(LimitSet)]
    if not isinstance(data, dict) or "source" not in data or set(data) - set(names):
        odd = sorted(map(str, set(data) - set(names))) if isinstance(data, dict) else []
        unknown = f"; unknown: {', '.join(odd)}{did_you_mean(odd[0], names)}" if odd else ""
        raise InputError(f"{where}source is needed, with any of {', '.join(names[1:])}{unknown}")
    if not isinstance(data["source"], str) or not data["source"].strip():
        raise InputError(f"{where}source is {data['source']!r}, expected the origin of the values, as text")
    for name in names[1:]:
        value = data.get(name, 1.0)
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0.0 < value <= sys.float_info.max:
            raise InputError(f"{where}{name} is {value!r}, expected a positive number")
    for measure in ("a8_mps2", "vdv_mps175"):
        action, limit = f"action_{measure}", f"limit_{measure}"
        if (action in data) != (limit in data):
            raise InputError(f"{where}{action} and {limit} belong together: give both or none")
        if action in data and data[limit] < data[action]:
            raise InputError(f"{where}{limit} lies below {action}, the limit value is the larger one")
    if len(data) == 1:
        raise InputError(f"{where}no value, give {', '.join(names[1:])} or a pair of them")
    values = {name: float(data[name]) if name in data else None for name in names[1:]}
    return LimitSet(source=data["source"].strip(), **values)
