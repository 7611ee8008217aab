"""Limits: the seat's exposure against action and limit values, and the time left (Directive 2002/44/EC).

Colours, times and projections use the seat alone, never a prediction.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import yaml

from biodyn_core.errors import InputError
from biodyn_core.exposure import Dose, HorizontalMeter

HORIZONTAL_FACTOR: Final = 1.4
"""k of the horizontal axes for health, seated (ISO 2631-1:1997, 7.2.3; 2002/44/EC)."""

EIGHT_HOURS_S: Final = 8.0 * 3600.0


@dataclass(frozen=True)
class Limits:
    """Action and limit values: A(8) m/s^2 and VDV m/s^1.75, with where they come from."""

    source: str
    action_a8_mps2: float
    action_vdv_mps175: float
    limit_a8_mps2: float
    limit_vdv_mps175: float

    def to_dict(self) -> dict[str, Any]:
        """Return the values by name."""
        return dict(self.__dict__)


EU_LIMITS: Final = Limits("2002/44/EC", 0.5, 9.1, 1.15, 21.0)


def load_limits(path: str | Path) -> Limits:
    """Read a limits file (the keys of `Limits`); raises InputError naming file and key."""
    try:
        data = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError, yaml.YAMLError) as error:
        raise InputError(f"{path}: cannot be read as YAML ({' '.join(str(error).split())})") from error
    names = tuple(Limits.__dataclass_fields__)
    if not isinstance(data, dict) or set(data) != set(names):
        odd = sorted(map(str, set(data) ^ set(names))) if isinstance(data, dict) else ["no keys at all"]
        raise InputError(
            f"{path}: exactly the keys {', '.join(names)} are needed; missing or unknown: {', '.join(odd)}"
        )
    for name in names[1:]:
        value = data[name]
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0.0 < value <= sys.float_info.max:
            raise InputError(f"{path}: {name} is {value!r}, expected a positive number")
    limits = Limits(str(data["source"]), *(float(data[name]) for name in names[1:]))
    for kind in ("a8_mps2", "vdv_mps175"):
        if getattr(limits, f"limit_{kind}") < getattr(limits, f"action_{kind}"):
            raise InputError(f"{path}: limit_{kind} lies below action_{kind}, the limit value is the larger one")
    return limits


@dataclass(frozen=True)
class SeatExposure:
    """The figures that decide: the seat's three axes, k factors applied where values are compared.

    axis names the governing one: x, y, z or worst_direction; times are None where they cannot be honest.
    """

    axis: str
    horizontal: str
    aw_weighted_mps2: dict[str, float]
    vdv_weighted_mps175: dict[str, float]
    a8_so_far_mps2: float
    vdv_so_far_mps175: float
    time_to_action_value_s: float | None
    time_to_limit_value_s: float | None
    governing: str
    seconds: float


def seat_exposure(
    vertical: Dose, horizontal: HorizontalMeter, yaw_rad: float | None, limits: Limits, trusted: bool
) -> SeatExposure:
    """Judge the seat: max(1.4 awx, 1.4 awy, awz) and the same for VDV (2002/44/EC), and the time left at this rate.

    Without a yaw the horizontal axes are unknown, and the largest over all directions stands for both. `trusted` is
    False when samples are clipped or more than 1 % are missing: then the times are withheld.
    """
    if yaw_rad is None:
        aws, vdvs = horizontal.along(np.linspace(0.0, np.pi, 361))
        aw, vdv = {"worst_direction": float(aws.max())}, {"worst_direction": float(vdvs.max())}
    else:
        aws, vdvs = horizontal.along([yaw_rad, yaw_rad + np.pi / 2.0])
        aw, vdv = dict(zip("xy", aws.tolist(), strict=True)), dict(zip("xy", vdvs.tolist(), strict=True))
    aw, vdv = {**aw, "z": vertical.aw_mps2}, {**vdv, "z": vertical.vdv_mps175}
    factor = {axis: 1.0 if axis == "z" else HORIZONTAL_FACTOR for axis in aw}
    axis = max(aw, key=lambda name: factor[name] * aw[name])
    governing_aw = factor[axis] * aw[axis]
    governing_vdv = max(factor[name] * vdv[name] for name in vdv)
    seconds = vertical.seconds
    times = {
        kind: _time_left_s(governing_aw, governing_vdv, seconds, a8, dose) if trusted and seconds > 0.0 else None
        for kind, a8, dose in (
            ("action", limits.action_a8_mps2, limits.action_vdv_mps175),
            ("limit", limits.limit_a8_mps2, limits.limit_vdv_mps175),
        )
    }
    a8 = governing_aw * math.sqrt(seconds / EIGHT_HOURS_S)
    by_a8 = a8 / limits.action_a8_mps2 >= governing_vdv / limits.action_vdv_mps175
    return SeatExposure(
        axis=axis,
        horizontal="worst_direction" if yaw_rad is None else "yaw_given",
        aw_weighted_mps2=aw,
        vdv_weighted_mps175=vdv,
        a8_so_far_mps2=a8,
        vdv_so_far_mps175=governing_vdv,
        time_to_action_value_s=times["action"],
        time_to_limit_value_s=times["limit"],
        governing="a8" if by_a8 else "vdv",
        seconds=seconds,
    )


def _time_left_s(aw: float, vdv: float, seconds: float, a8_value: float, vdv_value: float) -> float | None:
    """Seconds until A(8) or VDV reaches its value if exposure goes on as before; 0 once reached, None for never."""
    by_a8 = EIGHT_HOURS_S * (a8_value / aw) ** 2 if aw > 0.0 else math.inf
    by_vdv = seconds * (vdv_value / vdv) ** 4 if vdv > 0.0 else math.inf
    left = max(0.0, min(by_a8, by_vdv) - seconds)
    return left if math.isfinite(left) else None
