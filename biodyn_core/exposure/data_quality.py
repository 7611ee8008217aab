"""Data quality: losses and state of the seat, and why its exposure may be wrong or incomplete."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from biodyn_core.base.wording import counted
from biodyn_core.conditioning.tilt import is_gravity
from biodyn_core.exposure.losses import Losses
from biodyn_core.exposure.seat_axes import SeatAxes

MAX_MISSING_SHARE: Final = 0.01
"""With a larger share missing there are no times and no projections, and no zone below the action value."""

MAX_UNUSABLE_S: Final = 0.5
"""While all samples of the seat have been rejected for longer, there are no times, and no zone below a value."""


@dataclass(frozen=True)
class DataQuality:
    """Quality of the seat's data since reset: its losses and its state.

    silent: the seat sends no samples now, other sensors do. unusable_s: for so long all its samples were rejected.
    """

    losses: Losses
    silent: bool
    gravity_mps2: float | None
    fault: str | None
    unusable_s: float = 0.0

    def withheld(self, seconds: float) -> str | None:
        """Why times are withheld after so many counted seconds, None where they are given."""
        return self._unusable() or self._incomplete(seconds) or self._gravity_error()

    def lacks_axis(self, axes: SeatAxes) -> bool:
        """Whether a horizontal axis is missing or dead."""
        return axes.missing_axes > 0 or self.losses.dead_s > 0.0

    def uncertainty(self, seconds: float, axes: SeatAxes) -> str | None:
        """Why a value that is not reached may be reached all the same, None without a reason."""
        if self.fault is not None:
            return f"the seat gives no data ({self.fault})"
        if self.silent:
            return "the seat has fallen silent"
        if unusable := self._unusable():
            return unusable
        if incomplete := self._incomplete(seconds):
            return incomplete
        if self.losses.flat_s > 0.0:
            flat_s = f"{self.losses.flat_s:.3g} s"
            return f"{flat_s} of the seat's readings do not change at all, or not vertically: is it stuck?"
        if axes.missing_axes:
            return (
                "vertical only: the seat gives no horizontal data"
                if axes.horizontal == "missing"
                else "the seat gives no data on one of its horizontal axes"
            )
        if self.losses.dead_s > 0.0:
            return f"one axis of the seat does not change for {self.losses.dead_s:.3g} s while another one moves"
        return self._gravity_error()

    def _incomplete(self, seconds: float) -> str | None:
        """Reason that the record is incomplete, None if it is complete enough."""
        clipped, missing_s = self.losses.clipped, self.losses.missing_s
        if clipped > 0:
            return f"{counted(clipped, 'sample is', 'samples are')} clipped at the seat"
        if seconds <= 0.0:
            return "nothing was counted at the seat"
        if missing_s > MAX_MISSING_SHARE * (seconds + self.losses.absent_s):
            return f"{missing_s:.3g} s are missing at the seat, more than {100.0 * MAX_MISSING_SHARE:g} %"
        return None

    def _unusable(self) -> str | None:
        """Reason that the seat's samples are unusable now, None while they are not."""
        if self.unusable_s <= MAX_UNUSABLE_S:
            return None
        return f"the last {self.unusable_s:.3g} s of the seat's samples are unusable"

    def _gravity_error(self) -> str | None:
        """Description of a wrong gravity of the seat, None if it is right."""
        gravity = self.gravity_mps2
        if gravity is not None and is_gravity(gravity):
            return None
        reads = "nothing" if gravity is None else f"{gravity:.2f} m/s^2"
        return f"the seat reads {reads} for gravity, so its gain, unit or mounting may be wrong"
