"""Effects over whole recordings: what the body feels of the seat, and what sensors show of the body."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import SEGMENTS
from biodyn_core.effects.effect import AppliedEffect

Channels = Mapping[str, Floats]


def felt(effects: Iterable[AppliedEffect], seat_mps2: Floats, rate_hz: float, channels: Channels) -> Floats:
    """The vertical acceleration of the seat under the pelvis, (n,), from that under the sensor, (n,)."""
    for applied in effects:
        if applied.effect.seat is not None and not applied.absent:
            seat_mps2 = applied.effect.seat(seat_mps2, rate_hz, needed(applied, channels), applied.values)
    return seat_mps2


def shown(effects: Iterable[AppliedEffect], accel_mps2: Floats, rate_hz: float, channels: Channels) -> Floats:
    """What sensors show of the segments' true accelerations, both (n, 6)."""
    changed = accel_mps2
    for applied in effects:
        if applied.effect.measured is not None and not applied.absent:
            changed = changed.copy() if changed is accel_mps2 else changed
            column = changed[:, SEGMENTS.index(applied.site)]
            column[:] = applied.effect.measured(column.copy(), rate_hz, needed(applied, channels), applied.values)
    return changed


def needs_channels(effects: Iterable[AppliedEffect]) -> bool:
    """Whether more than verticals has to be measured for them."""
    return any(applied.effect.channels and not applied.absent for applied in effects)


def needed(applied: AppliedEffect, channels: Channels) -> dict[str, Floats]:
    """The channels that an effect needs, (n,) each, by the effect's names; `own.` stands for the site's.

    What is masked (NaN) drives nothing. Raises InputError for one that is not there.
    """
    found = {}
    for name, source in zip(applied.effect.channels, applied.effect.needed(applied.site), strict=True):
        if source not in channels:
            raise InputError(f"effect {applied.effect.name} needs the channel {source}, which is not measured here")
        found[name] = np.nan_to_num(channels[source])
    return found
