"""Limit assessment: the seat's exposure against action and limit values: zone, time left, projection to eight hours.

The seat alone decides, never a prediction. Directive 2002/44/EC; ISO 2631-1:1997.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from biodyn_core.base.segments import STANDARD_GRAVITY_MPS2
from biodyn_core.base.wording import counted, number, number_below
from biodyn_core.conditioning.conditioner import GRAVITY_TOLERANCE
from biodyn_core.exposure.exposure_store import Lost
from biodyn_core.exposure.limits import Kind, Limits, LimitSet, Measure
from biodyn_core.exposure.meters import Dose, HorizontalMeter

Zone = Literal["below_action_value", "above_action_value", "above_limit_value", "undecided"]
Horizontal = Literal["yaw_given", "worst_direction", "missing"]

HORIZONTAL_FACTOR: Final = 1.4
"""k of the horizontal axes for health, seated (ISO 2631-1:1997, 7.2.3; 2002/44/EC)."""

EIGHT_HOURS_S: Final = 8.0 * 3600.0
PROJECTION_AFTER_S: Final = 20.0 * 60.0
"""A shorter record carries no projection to eight hours unless it is asked for."""

MISSING_SHARE_TRUSTED: Final = 0.01
"""With more than this missing no time and no projection is given, and nothing is called below its action value."""

DEAD_SHARE: Final = 1e-6
"""An axis that moved less than this share of the strongest has no sensor behind it: any real one has more noise."""


@dataclass(frozen=True)
class DataQuality:
    """What a judgement stands on, since reset: what the seat lost, and its state.

    silent: the seat sends nothing now, others do.
    """

    lost: Lost
    silent: bool
    gravity_mps2: float | None
    fault: str | None


@dataclass(frozen=True)
class LimitAssessment:
    """The seat against one set of limits: zone with its reason, and the seconds left until action and limit value.

    governing: the measure that is nearest to (or furthest beyond) the value the zone speaks of, counted in time, so
    that it is also the one that reached it first; axis: that measure's axis. Times are None where withheld or never.
    """

    source: str
    zone: Zone
    zone_reason: str
    governing: Measure
    axis: str
    time_to_action_value_s: float | None
    time_to_limit_value_s: float | None


@dataclass(frozen=True)
class ShockRatio:
    """A ratio above whose threshold ISO 2631-1:1997 asks for additional evaluation; None where it was not measured."""

    name: str
    value: float | None
    threshold: float
    clause: str

    @property
    def exceeded(self) -> bool | None:
        """Whether it fires, None where that is unknown."""
        return None if self.value is None else self.value > self.threshold


@dataclass(frozen=True)
class SeatExposure(LimitAssessment):
    """The figures that decide, seat alone, and their judgement by the deciding set; `beside` that by the others.

    aw and VDV by axis are without k; A(8) and VDV so far are the largest over the axes with k = 1.4, 1.4, 1.0.
    lower_bound: samples are missing or clipped, or a horizontal axis is. withheld: why there are no times and no
    projections. projected_from_s: the seconds that were counted; projected_lower_bound: a horizontal axis is missing.
    shock_ratios: of the governing axis.
    """

    seconds: float
    horizontal: Horizontal
    aw_weighted_mps2: dict[str, float]
    vdv_weighted_mps175: dict[str, float]
    a8_so_far_mps2: float
    a8_axis: str
    vdv_so_far_mps175: float
    vdv_axis: str
    lower_bound: bool
    withheld: str | None
    a8_projected_8h_mps2: float | None
    vdv_projected_8h_mps175: float | None
    projected_from_s: float | None
    projected_lower_bound: bool
    shock_ratios: tuple[ShockRatio, ...]
    beside: tuple[LimitAssessment, ...]


def seat_exposure(
    vertical: Dose,
    horizontal: HorizontalMeter,
    yaw_rad: float | None,
    limits: Limits,
    grounds: DataQuality,
    project: bool = False,
) -> SeatExposure:
    """Judge the seat: max(1.4 awx, 1.4 awy, awz) and the same for VDV (2002/44/EC; ISO 2631-1:1997, 7.2.3).

    Without a yaw the horizontal axes are unknown, and the largest over all directions stands for both: never less than
    either. project: to eight hours from less than 20 minutes too.
    """
    axes = _Axes.of(vertical, horizontal, yaw_rad)
    a8_axis, vdv_axis = axes.largest(axes.aw_mps2), axes.largest(axes.vdv_mps175)
    seconds = vertical.seconds
    felt = _Felt(
        {
            "a8": axes.factor(a8_axis) * axes.aw_mps2[a8_axis] * math.sqrt(seconds / EIGHT_HOURS_S),
            "vdv": axes.factor(vdv_axis) * axes.vdv_mps175[vdv_axis],
        },
        {"a8": a8_axis, "vdv": vdv_axis},
        seconds,
        grounds.lost,
        at_least=grounds.lost.lower_bound or axes.dead > 0,
        withheld=_withheld(grounds, seconds),
        doubt=_doubt(grounds, seconds, axes),
    )
    deciding = _judge(limits.deciding, felt)
    projects = felt.withheld is None and (project or seconds >= PROJECTION_AFTER_S) and seconds <= EIGHT_HOURS_S
    scale = EIGHT_HOURS_S / seconds if projects else math.nan
    return SeatExposure(
        **vars(deciding),
        seconds=seconds,
        horizontal=axes.horizontal,
        aw_weighted_mps2=axes.aw_mps2,
        vdv_weighted_mps175=axes.vdv_mps175,
        a8_so_far_mps2=felt.so_far["a8"],
        a8_axis=a8_axis,
        vdv_so_far_mps175=felt.so_far["vdv"],
        vdv_axis=vdv_axis,
        lower_bound=felt.at_least,
        withheld=felt.withheld,
        a8_projected_8h_mps2=felt.so_far["a8"] * math.sqrt(scale) if projects else None,
        vdv_projected_8h_mps175=felt.so_far["vdv"] * scale**0.25 if projects else None,
        projected_from_s=seconds if projects else None,
        projected_lower_bound=axes.dead > 0,
        shock_ratios=_shock_ratios(vertical, axes, deciding.axis),
        beside=tuple(_judge(each, felt) for each in limits.beside),
    )


@dataclass(frozen=True)
class _Axes:
    """The axes that are known, without k; dead: how many horizontal axes of the sensor did not move at all."""

    aw_mps2: dict[str, float]
    vdv_mps175: dict[str, float]
    horizontal: Horizontal
    dead: int

    @classmethod
    def of(cls, vertical: Dose, plane: HorizontalMeter, yaw_rad: float | None) -> _Axes:
        first, second = plane.along([0.0, np.pi / 2.0])[0].tolist()
        least = DEAD_SHARE * max(first, second, vertical.aw_mps2)
        dead = (first <= least) + (second <= least)
        up_aw, up_vdv = {"z": vertical.aw_mps2}, {"z": vertical.vdv_mps175}
        if dead == 2:
            return cls(up_aw, up_vdv, "missing", dead)
        if yaw_rad is None:
            aws, vdvs = plane.along(np.linspace(0.0, np.pi, 361))
            aw, vdv = {"worst_direction": float(aws.max())}, {"worst_direction": float(vdvs.max())}
            return cls(aw | up_aw, vdv | up_vdv, "worst_direction", dead)
        aws, vdvs = plane.along([yaw_rad, yaw_rad + np.pi / 2.0])
        aw, vdv = dict(zip("xy", aws.tolist(), strict=True)), dict(zip("xy", vdvs.tolist(), strict=True))
        return cls(aw | up_aw, vdv | up_vdv, "yaw_given", dead)

    @staticmethod
    def factor(axis: str) -> float:
        return 1.0 if axis == "z" else HORIZONTAL_FACTOR

    def largest(self, figures: dict[str, float]) -> str:
        """The axis with the largest figure, k applied; z of equals, so that a seat at rest is not called x."""
        return max(figures, key=lambda axis: (self.factor(axis) * figures[axis], axis))


@dataclass(frozen=True)
class _Felt:
    """A(8) and VDV so far with their axes, and how far they can be relied on."""

    so_far: dict[Measure, float]
    axis: dict[Measure, str]
    counted_s: float
    lost: Lost
    at_least: bool
    withheld: str | None
    doubt: str | None

    @property
    def elapsed_s(self) -> float:
        """Since reset: what was interpolated, or did not change, was counted."""
        return self.counted_s + self.lost.absent_s

    def used(self, measure: Measure, value: float) -> float:
        """The share used up of the time after which the value is reached: at 1 it is.

        A(8)^2 and VDV^4 grow in proportion to time when exposure goes on as before.
        """
        square = (self.so_far[measure] / value) * (self.so_far[measure] / value)
        return square if measure == "a8" else square * square

    def left_s(self, used: float) -> float | None:
        """Seconds until then if exposure went on, and goes on, as it was counted; None for never or withheld.

        The seconds of which there is nothing have passed as well: they are taken off what is left.
        """
        if self.withheld is not None or used == 0.0:
            return None
        left = max(0.0, self.counted_s / used - self.elapsed_s)
        return left if math.isfinite(left) else None


def _judge(limits: LimitSet, felt: _Felt) -> LimitAssessment:
    used: dict[Kind, dict[Measure, float]] = {
        kind: {measure: felt.used(measure, value) for measure, value in limits.values(kind).items()}
        for kind in ("action", "limit")
    }
    action, limit = max(used["action"].values()), max(used["limit"].values())
    at: Kind = "limit" if limit >= 1.0 else "action"
    governing = max(used[at], key=lambda measure: used[at][measure])
    zone: Zone = "undecided"
    if limit >= 1.0:
        zone, reason = "above_limit_value", _reached(limits, felt, "limit", governing)
    elif action >= 1.0:
        zone, reason = "above_action_value", _reached(limits, felt, "action", governing)
        if felt.doubt:
            reason += f"; whether the limit value is reached too is undecided, because {felt.doubt}"
    elif felt.doubt:
        reason = f"no value of {limits.source} is reached by what was counted, but {felt.doubt}"
    elif action * felt.elapsed_s / felt.counted_s < 1.0:
        zone, reason = "below_action_value", _below(limits, felt)
    else:
        reason = (
            f"the action value of {limits.source} is not reached by what was counted, but would be"
            f" if the {felt.lost.missing_s:.3g} s missing were like the rest"
        )
    return LimitAssessment(
        source=limits.source,
        zone=zone,
        zone_reason=reason,
        governing=governing,
        axis=felt.axis[governing],
        time_to_action_value_s=felt.left_s(action),
        time_to_limit_value_s=felt.left_s(limit),
    )


_NAME: Final[dict[Measure, str]] = {"a8": "A(8)", "vdv": "VDV"}
_UNIT: Final[dict[Measure, str]] = {"a8": "m/s^2", "vdv": "m/s^1.75"}


def _reached(limits: LimitSet, felt: _Felt, kind: Kind, measure: Measure) -> str:
    least, value = "at least " if felt.at_least else "", limits.values(kind)[measure]
    shown = f"{least}{number(felt.so_far[measure])}"
    return f"{_so_far(felt, measure, shown)}: the {kind} value of {value:g} ({limits.source}) is reached"


def _below(limits: LimitSet, felt: _Felt) -> str:
    values = limits.values("action")
    figures = " and ".join(
        _so_far(felt, measure, number_below(felt.so_far[measure], values[measure])) for measure in values
    )
    stated = f"value{'s' if len(values) > 1 else ''} of {' and '.join(f'{value:g}' for value in values.values())}"
    missing_s, allowed = felt.lost.missing_s, f"within the {100.0 * MISSING_SHARE_TRUSTED:g} % allowed"
    missing = f"; {missing_s:.3g} s are missing, {allowed}" if missing_s > 0.0 else ""
    return f"{figures}: below the action {stated} ({limits.source}){missing}"


def _so_far(felt: _Felt, measure: Measure, shown: str) -> str:
    axis = felt.axis[measure]
    where = "worst horizontal direction" if axis == "worst_direction" else f"axis {axis}"
    return f"{_NAME[measure]} so far is {shown} {_UNIT[measure]} ({where})"


def _withheld(grounds: DataQuality, seconds: float) -> str | None:
    """Why nothing is extrapolated from this record, None where it may be."""
    return _lacking(grounds, seconds) or _off(grounds)


def _lacking(grounds: DataQuality, seconds: float) -> str | None:
    """What the record lacks, None where that is little."""
    count, missing = grounds.lost.clipped, grounds.lost.missing_s
    if count > 0:
        return f"{counted(count, 'sample is', 'samples are')} clipped at the seat"
    if seconds <= 0.0:
        return "nothing was counted at the seat"
    if missing > MISSING_SHARE_TRUSTED * (seconds + grounds.lost.absent_s):
        return f"{missing:.3g} s are missing at the seat, more than {100.0 * MISSING_SHARE_TRUSTED:g} %"
    return None


def _doubt(grounds: DataQuality, seconds: float, axes: _Axes) -> str | None:
    """Why a value that was not reached may have been all the same, None where there is no reason to think so."""
    if grounds.fault is not None:
        return f"the seat answers nothing ({grounds.fault})"
    if grounds.silent:
        return "the seat has fallen silent"
    if lacking := _lacking(grounds, seconds):
        return lacking
    if grounds.lost.flat_s > 0.0:
        return f"{grounds.lost.flat_s:.3g} s of the seat's readings do not change at all: is it stuck?"
    if axes.dead:
        return (
            "vertical only: the seat gives no horizontal data"
            if axes.horizontal == "missing"
            else "the seat gives no data on one of its horizontal axes"
        )
    return _off(grounds)


def _off(grounds: DataQuality) -> str | None:
    """What gravity says of the seat's readings, None where it reads as it should."""
    gravity = grounds.gravity_mps2
    if gravity is not None and abs(gravity / STANDARD_GRAVITY_MPS2 - 1.0) <= GRAVITY_TOLERANCE:
        return None
    reads = "nothing" if gravity is None else f"{gravity:.2f} m/s^2"
    return f"the seat reads {reads} for gravity, so its gain, unit or mounting may be off"


def _shock_ratios(vertical: Dose, axes: _Axes, axis: str) -> tuple[ShockRatio, ...]:
    """The ratios of ISO 2631-1:1997 that tell whether rms is enough; peak and MTVV are measured for the vertical.

    Of both MTVV the larger decides, as 6.3.3 leaves open which average it means.
    """
    aw, vdv = axes.aw_mps2[axis], axes.vdv_mps175[axis]
    steady = aw * vertical.seconds**0.25
    up = steady > 0.0 and axis == "z"
    return (
        ShockRatio("crest_factor", vertical.crest_factor if up else None, 9.0, "6.2.2"),
        ShockRatio("mtvv_over_aw", vertical.mtvv_mps2 / aw if up else None, 1.5, "6.3.3"),
        ShockRatio("vdv_over_aw_t", vdv / steady if steady > 0.0 else None, 1.75, "6.3.3"),
    )
