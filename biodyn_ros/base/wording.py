"""Numbers and names as text, for pages and the terminal."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Container, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Final

from biodyn_core.base.wording import counted, decimal_places, number

if TYPE_CHECKING:
    from biodyn_core.body.origin import Origin
    from biodyn_core.exposure.injury import Dri
    from biodyn_core.exposure.losses import Losses

_GROUPS: Final = {
    "natural_frequency_hz": "natural frequency",
    "damping_ratio": "damping ratio",
    "rayleigh_rad_per_s": "Rayleigh damping",
    "stiffening_scale": "stiffening scale",
    "mass_scale": "mass scale",
}

_UNIT: Final = re.compile(r"(_n|_m|_s)?_(per_m2|per_m|per_n|s_per_m|mps2|mps|hz|kg|m|s|n)$")
"""The unit at the end of a parameter's name."""

MODEL: Final = "the model"

DOES_NOT_FIT: Final = "does not fit"
FITS_AGAIN: Final = "fits again"
"""Ends of the marks of the live node about a segment, as in `head: does not fit`."""

LIFTS_OFF: Final = "The tension between seat and pelvis exceeds the static weight: a real body would lift off there."

FORCES_NOT_MEASURED: Final = "no force in people was measured to compare them with"

INTERVAL_MEANS: Final = (
    "95 % interval of the true figure, from the residual in events that the subject was not fitted to, and from the"
    " uncertainty of its parameters."
)

INTERVAL_OF_GROUP: Final = (
    "The 95 % interval is that of people of this mass in published groups. What the model misses of them is not in it."
)

ORIGIN: Final[dict[Origin, str]] = {
    "person": "fitted to recordings of this person",
    "group": "of published groups of people, without a recording of this person",
    "paper": "printed in the paper, whose recordings are not public",
    "edited": "changed by hand since its file was written",
    "unknown": "of unknown origin, which its file does not state",
}
"""Where a subject's parameters are from; continues `parameters`."""

INTERVAL_OF_MISFIT: Final = (
    "The interval does not hold while the model does not fit, as in a part of this record or in all of it."
)

INTERVAL_OF_BOUND: Final = "The interval of a lower bound is that of the counted part."

REJECTED: Final = {
    "unset": ("stamp never set", "stamps never set"),
    "stray": ("implausible stamp", "implausible stamps"),
    "late": ("sample too late", "samples too late"),
    "duplicate": ("sample that came twice", "samples that came twice"),
    "non_finite": ("reading that is no number, or impossible", "readings that are no numbers, or impossible"),
}
"""Text for one and for several rejected samples, by the name of their count in `SensorStatus`."""

UNITS_TYPESET: Final = {"m/s^2": "m/s²", "m/s^1.75": "m/s¹·⁷⁵", "m/s^1.5": "m/s¹·⁵"}
"""Units in messages (terminal, JSON), and their form on pages."""

MAX_EXTRA_DECIMALS: Final = 3
"""An interval has at most so many decimal places more than a number has."""


def losses_text(losses: Losses) -> str:
    """What the figures of a sensor lack: missing seconds, clipped samples, seconds left out; empty without losses."""
    missing, suspect = (f"{seconds:.3f} s" for seconds in (losses.missing_s, losses.suspect_s))
    parts = [
        f"{missing} missing" if losses.missing_s > 0.0 else "",
        f"{counted(losses.clipped, 'sample')} clipped" if losses.clipped else "",
        f"{suspect} left out after losses within strong motion" if losses.suspect_s > 0.0 else "",
    ]
    return ", ".join(part for part in parts if part)


def unchanging(flat: int, dead: int) -> list[str]:
    """The warnings about samples whose value does not change, or one axis of it while another one moves."""
    lines = [f"{counted(flat, 'sample')} with an unchanging value counted as missing: stuck sensor?"] if flat else []
    if dead:
        lines.append(f"{counted(dead, 'sample')} with an axis that does not change while another one moves: dead axis?")
    return lines


def rejected(counts: Mapping[str, int]) -> str:
    """Rejected samples by cause, from their counts; empty without any."""
    return "; ".join(counted(counts[cause], *text) for cause, text in REJECTED.items() if counts.get(cause))


def left_range(samples: int) -> str:
    """The warning about samples at which the model left its range."""
    return f"left its range at {counted(samples, 'sample')}: no prediction there, restarted at rest"


def misfit_line(segment: str, since: str, ratio: float) -> str:
    """A segment that the model does not fit, with the residual's rms over the usual one."""
    return f"{words(segment)}: {DOES_NOT_FIT} {since}, {number(ratio)} times what is usual"


def ends(interval: tuple[float, float]) -> str:
    """Both ends of an interval: 0.410 to 0.500."""
    return f"{number(interval[0])} to {number(interval[1])}"


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


def dri_band(dri: Dri, lower: bool) -> str:
    """The band of a DRI; of a lower bound the lowest possible one."""
    return f"at least band {dri.band}" if lower and not dri.is_in_highest_band else f"band {dri.band}"


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
    """`natural_frequency_hz[head]` is "natural frequency, head", and `stop gap_m[head]` "gap of stop, head"."""
    group, _, segment = name.partition("[")
    effect, _, parameter = group.partition(" ")
    what = f"{without_unit(parameter)} of {words(effect)}" if parameter else _GROUPS[group]
    return f"{what}, {words(segment.rstrip(']'))}" if segment else what


def without_unit(name: str) -> str:
    """A parameter's name as words, without the unit at its end: `gap_m` is "gap"."""
    return words(_UNIT.sub("", name))


def compared_without(effects: str) -> str:
    """That streams are compared with the prediction of the segment itself."""
    return f"compared without the effect of its sensor ({effects}), which fit, validate and trace apply"


def partly_tested(segments: Collection[str]) -> str:
    """For which segments the fit was tested, " (tested: head, neck)"; empty if for all that have a sensor."""
    from biodyn_core.base.segments import MEASURED_SEGMENTS  # needs numpy, which `biodyn -h` does without

    names = [words(name) for name in MEASURED_SEGMENTS if name in segments]
    return "" if len(names) == len(MEASURED_SEGMENTS) else f" (tested: {listed(names)})"


def sentence(text: str) -> str:
    """The text with a capital first letter and a full stop."""
    return f"{text[:1].upper()}{text[1:]}{'' if text.endswith('?') else '.'}"


def listed(names: Iterable[str]) -> str:
    """The first twelve names, and the number of further ones; "none" without any."""
    names = list(names)
    more = f" and {len(names) - 12} more" if len(names) > 12 else ""
    return f"{', '.join(names[:12])}{more}" or "none"
