"""Effects on whole recordings: changes of the seat's motion and of the sensors' readings."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TypeVar

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import SEGMENTS
from biodyn_core.effects.effect import AppliedEffect, Channels, Effect, SeatTransform, SensorTransform

EffectT = TypeVar("EffectT", bound=Effect)


def active(effects: Iterable[AppliedEffect], kind: type[EffectT]) -> list[tuple[AppliedEffect, EffectT]]:
    """The effects of one kind, without those of zero strength."""
    return [(one, one.effect) for one in effects if isinstance(one.effect, kind) and not one.absent]


def apply_to_seat(effects: Iterable[AppliedEffect], seat_mps2: Floats, rate_hz: float, channels: Channels) -> Floats:
    """The vertical acceleration of the seat under the pelvis, (n,), from that under the sensor, (n,)."""
    for applied, effect in active(effects, SeatTransform):
        seat_mps2 = effect.transform(seat_mps2, rate_hz, _channels_of(applied, channels), applied.values)
    return seat_mps2


def apply_to_sensors(
    effects: Iterable[AppliedEffect], accel_mps2: Floats, rate_hz: float, channels: Channels
) -> Floats:
    """The sensors' readings of the segments' true accelerations, both (n, 6); the input stays unchanged."""
    changed = accel_mps2
    for applied, effect in active(effects, SensorTransform):
        changed = changed.copy() if changed is accel_mps2 else changed
        column = changed[:, SEGMENTS.index(applied.site)]
        column[:] = effect.transform(column.copy(), rate_hz, _channels_of(applied, channels), applied.values)
    return changed


def needs_channels(effects: Iterable[AppliedEffect]) -> bool:
    """Whether the effects need channels beyond the verticals."""
    return any(effect.channels for _, effect in active(effects, Effect))


def beyond_vertical(effects: Iterable[AppliedEffect]) -> AppliedEffect | None:
    """The first effect on predictions that needs more than the seat's vertical, sample by sample; None without one."""
    return next((one for one, effect in active(effects, Effect) if not effect.supports_live), None)


def _channels_of(applied: AppliedEffect, channels: Channels) -> dict[str, Floats]:
    """The channels (n,) that an effect needs, by the effect's own names, with 0 for masked samples (NaN).

    Raises InputError for a channel that was not measured.
    """
    found = {}
    for name, source in zip(applied.effect.channels, applied.effect.required_channels(applied.site), strict=True):
        if source not in channels:
            raise InputError(f"effect {applied.effect.name} needs the channel {source}, which is not measured here")
        found[name] = np.nan_to_num(channels[source])
    return found
