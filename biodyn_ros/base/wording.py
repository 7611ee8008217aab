"""Numbers and names as text, for pages and the terminal."""

from __future__ import annotations

import math
from collections.abc import Container, Sequence
from typing import Any, Final

from biodyn_core.base.wording import counted, decimal_places, number

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
_GROUPS: Final = {
    "natural_frequency_hz": "natural frequency",
    "damping_ratio": "damping ratio",
    "rayleigh_rad_per_s": "Rayleigh damping",
    "stiffening_scale": "stiffening scale",
    "mass_scale": "mass scale",
}
_RATIO: Final = {"crest_factor": "crest factor", "mtvv_over_aw": "MTVV/aw", "vdv_over_aw_t": "VDV/(aw T^1/4)"}

MODEL: Final = "the model"

UNITS_TYPESET: Final = {"m/s^2": "m/s²", "m/s^1.75": "m/s¹·⁷⁵", "m/s^1.5": "m/s¹·⁵"}
"""Units in messages (terminal, JSON), and their form on pages."""

MAX_EXTRA_DECIMALS: Final = 3
"""An interval has at most so many decimal places more than a number has."""


def stuck(samples: int) -> str:
    """The warning about samples whose value does not change."""
    return f"{counted(samples, 'sample')} with an unchanging value counted as missing: stuck sensor?"


def left_range(samples: int) -> str:
    """The warning about samples at which the model left its range."""
    return f"left its range at {counted(samples, 'sample')}: no prediction there, restarted at rest"


def with_interval(value: float | None, lower: float | None, upper: float | None) -> tuple[str, str, str]:
    """A value and the ends of its interval, formatted as by `number`, with more decimals if they would look equal."""
    if value is None or lower is None or upper is None or not 0.0 < upper - lower < math.inf:
        return number(value), number(lower), number(upper)
    half = 0.5 * (upper - lower)
    needed = min(-math.floor(math.log10(half)), (decimal_places(value) or 0) + MAX_EXTRA_DECIMALS)
    shown = []
    for each in (value, lower, upper):
        places = decimal_places(each)
        shown.append(number(each) if places is None else f"{each:.{max(places, needed)}f}")
    return shown[0], shown[1], shown[2]


def bound(value: float | None, lower: bool) -> str:
    """The number, with ">=" before it where it is a lower bound."""
    return f">= {number(value)}" if lower and value is not None else number(value)


def span(window_s: Sequence[float] | None) -> str:
    """Start and end of a time window to a millisecond: 2.317 to 2.332; a dash for None."""
    return "–" if window_s is None else f"{window_s[0]:.3f} to {window_s[1]:.3f}"


def typeset(text: str) -> str:
    """The text with its units in superscripts."""
    for plain, shown in UNITS_TYPESET.items():
        text = text.replace(plain, shown)
    return text


def table(rows: Sequence[Sequence[str]], left: Container[int]) -> list[str]:
    """Rows as aligned lines: the columns whose indices are in `left` are left-aligned, the others right-aligned."""
    columns = list(zip(*rows, strict=True))
    aligned = [
        [f"{cell:{'<' if k in left else '>'}{max(map(len, column))}}" for cell in column]
        for k, column in enumerate(columns)
    ]
    return ["  ".join(row).rstrip() for row in zip(*aligned, strict=True)]


def duration(seconds: float, at_most: bool = False) -> str:
    """A duration, rounded down to be safe: 8.4 s, 12 min, 3 h 20 min, more than 24 h.

    at_most: the duration is an upper bound, so that "more than" would be wrong: 41 h.
    """
    if seconds < 60.0:
        return f"{math.floor(10.0 * seconds) / 10.0:g} s"
    if seconds > 24.0 * 3600.0:
        return f"{math.floor(seconds / 3600.0)} h" if at_most else "more than 24 h"
    minutes = math.floor(seconds / 60.0)
    if minutes < 60:
        return f"{minutes} min"
    return f"{minutes // 60} h {minutes % 60} min"


def words(name: str) -> str:
    """An identifier as words: `lower_torso` is "lower torso"."""
    return name.replace("_", " ")


def parameter_name(name: str) -> str:
    """`natural_frequency_hz[head]` is "natural frequency, head"."""
    group, _, segment = name.partition("[")
    return f"{_GROUPS[group]}, {words(segment.rstrip(']'))}" if segment else _GROUPS[group]


def sentence(text: str) -> str:
    """The text with a capital first letter and a full stop."""
    return f"{text[:1].upper()}{text[1:]}{'' if text.endswith('?') else '.'}"


def left(kind: str, seat: dict[str, Any]) -> str:
    """The time left to the `kind` (action or limit) value, from the seat's mapping, in a few words."""
    if seat["zone"] in ("above_limit_value", f"above_{kind}_value"):  # a lower bound suffices for this
        return "reached"
    if seat["withheld"]:
        return "withheld"
    seconds = seat[f"time_to_{kind}_value_s"]
    if seconds is None:
        return "never reached at this rate"
    return f"at most {duration(seconds, at_most=True)} left" if seat["lower_bound"] else f"{duration(seconds)} left"


def time_left(kind: str, seat: dict[str, Any]) -> str:
    """The time left to the `kind` (action or limit) value, from the seat's mapping, as a sentence."""
    name, said = f"{kind.capitalize()} value", left(kind, seat)
    if said == "withheld":
        return f"{name}: time left withheld, because {seat['withheld']}."
    if seat[f"time_to_{kind}_value_s"] is None or said == "reached":
        return f"{name}: {said}."
    return f"{name}: {said}, if exposure continues at this rate."


def shocks(seat: dict[str, Any]) -> str:
    """Whether ISO 2631-1 requires more than the rms on the governing axis, from the seat's mapping."""
    ratios = {_RATIO[name]: ratio for name, ratio in seat["shock_ratios"].items() if name in _RATIO}
    where = f"ISO 2631-1:1997, axis {words(seat['axis'])}"
    firing = [
        f"{name} {number(ratio['value'])} > {ratio['threshold']:g} ({ratio['clause']})"
        for name, ratio in ratios.items()
        if ratio["exceeded"]
    ]
    if firing:
        return f"Shocks: additional evaluation required ({where}): {', '.join(firing)}."
    unknown = [name for name, ratio in ratios.items() if ratio["exceeded"] is None]
    if seat["lower_bound"] or unknown:
        why = f"{' and '.join(unknown)} not measured" if unknown else "the seat's values are lower bounds"
        return f"Shocks: undecided whether additional evaluation is required ({where}): {why}."
    known = ", ".join(f"{name} {number(ratio['value'])}" for name, ratio in ratios.items())
    return f"Shocks: no additional evaluation required ({where}): {known}."
