"""Limit assessment: the seat's exposure against action and limit values: zone, time left, projection to eight hours.

The measured seat alone is assessed, never a prediction. Directive 2002/44/EC; ISO 2631-1:1997.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

from biodyn_core.base.wording import number, number_below
from biodyn_core.exposure.data_quality import MAX_MISSING_SHARE, DataQuality
from biodyn_core.exposure.limits import KINDS, Kind, Limits, LimitSet, Measure
from biodyn_core.exposure.losses import Losses
from biodyn_core.exposure.meters import Dose, HorizontalMeter
from biodyn_core.exposure.seat_axes import Horizontal, SeatAxes, axes_without_data
from biodyn_core.exposure.shock_ratios import ShockRatio, shock_ratios

Zone = Literal["below_action_value", "above_action_value", "above_limit_value", "undecided"]

EIGHT_HOURS_S: Final = 8.0 * 3600.0
PROJECTION_AFTER_S: Final = 20.0 * 60.0
"""A shorter record has a projection to eight hours only on request."""


@dataclass(frozen=True)
class LimitAssessment:
    """The seat against one set of limits: zone with its reason, and the seconds left until action and limit value.

    may_be_reached: the highest value that is reached with suspect samples alone, None without one. governing: the
    measure that reaches the zone's value first, in time; axis: that measure's axis. Times are None where they are
    withheld or if the value is never reached.
    """

    source: str
    zone: Zone
    zone_reason: str
    may_be_reached: Kind | None
    governing: Measure
    axis: str
    time_to_action_value_s: float | None
    time_to_limit_value_s: float | None


@dataclass(frozen=True)
class SeatExposure(LimitAssessment):
    """The seat's figures and their assessment by the deciding set; `additional`: by the other sets.

    aw and VDV by axis are without k; A(8) and VDV so far are the largest over the axes with k = 1.4, 1.4, 1.0.
    lower_bound: samples are missing, clipped or suspect, or an axis is missing or dead. suspect_s: the counted seconds
    that are in no figure but in times and projections. is_estimate: these contain suspect seconds or hidden motion.
    withheld: why there are no times and no projections. projected_from_s: the counted seconds; projected_lower_bound:
    an axis is missing or dead. shock_ratios: of the governing axis.
    """

    seconds: float
    suspect_s: float
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
    additional: tuple[LimitAssessment, ...]
    is_estimate: bool = False


def seat_exposure(
    vertical: Dose,
    horizontal: HorizontalMeter,
    yaw_rad: float | None,
    limits: Limits,
    quality: DataQuality,
    project: bool = False,
    with_suspect: Dose | None = None,
    with_hidden: Dose | None = None,
) -> SeatExposure:
    """Assess the seat: max(1.4 awx, 1.4 awy, awz) and the same for VDV (2002/44/EC; ISO 2631-1:1997, 7.2.3).

    Without a yaw the horizontal axes are unknown, and the largest over all directions is used for both, a value never
    below either. project: to eight hours from less than 20 minutes too.

    with_suspect: the vertical with suspect samples, None without any; with_hidden: the same with what losses within
    strong motion may hide. Only without both a value is surely reached; times, projections and the zone below a value
    contain both.
    """
    complete, has_suspect, seconds = with_suspect or vertical, with_suspect is not None, vertical.seconds
    missing_axes = axes_without_data(complete, horizontal, has_suspect)
    axes = SeatAxes.of(vertical, horizontal, yaw_rad, missing_axes)
    all_axes = SeatAxes.of(complete, horizontal, yaw_rad, missing_axes, has_suspect)
    hidden_axes = SeatAxes.of(with_hidden or complete, horizontal, yaw_rad, missing_axes, has_suspect)
    sure, whole = (_counted(each, seconds, quality) for each in (axes, hidden_axes))
    whole = dataclasses.replace(whole, has_hidden=with_hidden not in (None, complete))
    deciding = _assess(limits.deciding, sure, whole)
    withheld = whole.withheld or _doubt(limits.deciding, sure, whole)
    projects = withheld is None and (project or seconds >= PROJECTION_AFTER_S) and seconds <= EIGHT_HOURS_S
    scale = EIGHT_HOURS_S / seconds if projects else math.nan
    return SeatExposure(
        **vars(deciding),
        seconds=seconds,
        suspect_s=quality.losses.suspect_s,
        horizontal=axes.horizontal,
        aw_weighted_mps2=axes.aw_mps2,
        vdv_weighted_mps175=axes.vdv_mps175,
        a8_so_far_mps2=sure.so_far["a8"],
        a8_axis=sure.axis["a8"],
        vdv_so_far_mps175=sure.so_far["vdv"],
        vdv_axis=sure.axis["vdv"],
        lower_bound=sure.lower_bound,
        withheld=withheld,
        a8_projected_8h_mps2=whole.so_far["a8"] * math.sqrt(scale) if projects else None,
        vdv_projected_8h_mps175=whole.so_far["vdv"] * scale**0.25 if projects else None,
        projected_from_s=seconds if projects else None,
        projected_lower_bound=quality.lacks_axis(axes),
        shock_ratios=shock_ratios((vertical, axes), (complete, all_axes), deciding.axis),
        additional=tuple(_assess(each, sure, whole) for each in limits.additional),
        is_estimate=whole.has_hidden or quality.losses.suspect_s > 0.0,
    )


@dataclass(frozen=True)
class _Counted:
    """A(8) and VDV so far with their axes, and their reliability.

    withheld: why times are withheld; uncertainty: why a value that is not reached may be reached all the same.
    """

    so_far: dict[Measure, float]
    axis: dict[Measure, str]
    counted_s: float
    losses: Losses
    lower_bound: bool
    withheld: str | None
    uncertainty: str | None
    has_hidden: bool = False

    @property
    def elapsed_s(self) -> float:
        """Seconds since reset; interpolated and flat ones are among the counted."""
        return self.counted_s + self.losses.absent_s

    def used(self, measure: Measure, value: float) -> float:
        """The used share of the time until the value is reached, 1 where it is reached.

        A(8)^2 and VDV^4 grow in proportion to time at constant exposure.
        """
        square = (self.so_far[measure] / value) * (self.so_far[measure] / value)
        return square if measure == "a8" else square * square

    def left_s(self, used: float) -> float | None:
        """Seconds until the value is reached at the counted mean exposure; None for never or withheld.

        Absent seconds have passed as well and are subtracted.
        """
        if self.withheld is not None or used == 0.0:
            return None
        left = max(0.0, self.counted_s / used - self.elapsed_s)
        return left if math.isfinite(left) else None


def _counted(axes: SeatAxes, seconds: float, quality: DataQuality) -> _Counted:
    a8_axis, vdv_axis = axes.largest(axes.aw_mps2), axes.largest(axes.vdv_mps175)
    return _Counted(
        {
            "a8": axes.factor(a8_axis) * axes.aw_mps2[a8_axis] * math.sqrt(seconds / EIGHT_HOURS_S),
            "vdv": axes.factor(vdv_axis) * axes.vdv_mps175[vdv_axis],
        },
        {"a8": a8_axis, "vdv": vdv_axis},
        seconds,
        quality.losses,
        lower_bound=quality.losses.lower_bound or quality.lacks_axis(axes),
        withheld=quality.withheld(seconds),
        uncertainty=quality.uncertainty(seconds, axes),
    )


class _Used(NamedTuple):
    """The used share of the time until a value of a kind is reached, the measure that reaches it first, the value."""

    share: float
    measure: Measure
    value: float


def _used(limits: LimitSet, exposure: _Counted, kind: Kind) -> _Used:
    found = (_Used(exposure.used(name, value), name, value) for name, value in limits.values(kind).items())
    return max(found, key=lambda used: used.share)


def _may_be_reached(limits: LimitSet, sure: _Counted, whole: _Counted) -> Kind | None:
    """The highest value that the exposure reaches with suspect samples and hidden motion alone."""
    with_them = [kind for kind in KINDS if _used(limits, whole, kind).share >= 1.0 > _used(limits, sure, kind).share]
    return with_them[-1] if with_them else None


def _doubt(limits: LimitSet, sure: _Counted, whole: _Counted) -> str | None:
    """Why a value may be reached that is not surely reached."""
    if (kind := _may_be_reached(limits, sure, whole)) is None:
        return None
    _, measure, value = _used(limits, whole, kind)
    return (
        f"{_NAME[measure]} is {number(whole.so_far[measure])} {_UNIT[measure]} ({kind} value {value:g}) with"
        f" {_uncertain(whole)}"
    )


def _assess(limits: LimitSet, sure: _Counted, whole: _Counted) -> LimitAssessment:
    """Assess the exposure without suspect samples (`sure`), and with them and with hidden motion (`whole`)."""
    action, limit = (_used(limits, whole, kind) for kind in KINDS)
    sure_action, sure_limit = (_used(limits, sure, kind) for kind in KINDS)
    suspect = _doubt(limits, sure, whole)
    doubt = "; and ".join(reason for reason in (suspect, whole.uncertainty) if reason)
    governing, axes = limit.measure if limit.share >= 1.0 else action.measure, whole.axis
    zone: Zone = "undecided"
    if sure_limit.share >= 1.0:
        governing, axes = sure_limit.measure, sure.axis
        zone, reason = "above_limit_value", _reached(limits, sure, "limit", governing)
    elif sure_action.share >= 1.0:
        governing, axes = sure_action.measure, sure.axis
        zone, reason = "above_action_value", _reached(limits, sure, "action", governing)
        if doubt:
            reason += f"; whether the limit value is reached too is undecided, because {doubt}"
    elif doubt:
        reason = f"the counted exposure reaches no value of {limits.source}, but {doubt}"
    elif action.share * whole.elapsed_s / whole.counted_s < 1.0:
        zone, reason = "below_action_value", _below(limits, whole)
    else:
        reason = (
            f"the counted exposure does not reach the action value of {limits.source}, but would reach it"
            f" if the {whole.losses.missing_s:.3g} s missing were like the rest"
        )
    return LimitAssessment(
        source=limits.source,
        zone=zone,
        zone_reason=reason,
        may_be_reached=_may_be_reached(limits, sure, whole),
        governing=governing,
        axis=axes[governing],
        time_to_action_value_s=None if suspect and sure_action.share < 1.0 else whole.left_s(action.share),
        time_to_limit_value_s=None if suspect else whole.left_s(limit.share),
    )


_NAME: Final[dict[Measure, str]] = {"a8": "A(8)", "vdv": "VDV"}
_UNIT: Final[dict[Measure, str]] = {"a8": "m/s^2", "vdv": "m/s^1.75"}


def _reached(limits: LimitSet, exposure: _Counted, kind: Kind, measure: Measure) -> str:
    least, value = "at least " if exposure.lower_bound else "", limits.values(kind)[measure]
    shown = f"{least}{number(exposure.so_far[measure])}"
    return f"{_so_far(exposure, measure, shown)}: the {kind} value of {value:g} ({limits.source}) is reached"


def _below(limits: LimitSet, exposure: _Counted) -> str:
    values = limits.values("action")
    figures = " and ".join(
        _so_far(exposure, measure, number_below(exposure.so_far[measure], values[measure])) for measure in values
    )
    stated = f"value{'s' if len(values) > 1 else ''} of {' and '.join(f'{value:g}' for value in values.values())}"
    missing_s, allowed = exposure.losses.missing_s, f"within the {100.0 * MAX_MISSING_SHARE:g} % allowed"
    missing = f"; {missing_s:.3g} s are missing, {allowed}" if missing_s > 0.0 else ""
    if exposure.has_hidden or exposure.losses.suspect_s > 0.0:
        missing += f"; the figures are with {_uncertain(exposure)}"
    return f"{figures}: below the action {stated} ({limits.source}){missing}"


def _uncertain(exposure: _Counted) -> str:
    """What losses within strong motion make uncertain."""
    after = f"the {exposure.losses.suspect_s:.3g} s after losses within strong motion"
    if not exposure.has_hidden:
        return after
    if exposure.losses.suspect_s == 0.0:
        return "as much in the losses within strong motion as near them"
    return f"{after}, and with as much in these losses as near them"


def _so_far(exposure: _Counted, measure: Measure, shown: str) -> str:
    axis = exposure.axis[measure]
    where = "worst horizontal direction" if axis == "worst_direction" else f"axis {axis}"
    return f"{_NAME[measure]} so far is {shown} {_UNIT[measure]} ({where})"
