"""Losses: samples and seconds for which a sensor's figures are lower bounds."""

from __future__ import annotations

from typing import Final, NamedTuple


class Losses(NamedTuple):
    """Clipped samples, and seconds without a true measurement; each makes a sensor's figures lower bounds.

    absent_s: seconds without any sample; filled_s: interpolated seconds; flat_s: seconds of a reading that never
    changes. Filled and flat seconds are counted like measured ones. dead_s: seconds in which one axis never changes
    while another one moves. They make the seat's horizontal figures and the head's HIC lower bounds; those in which it
    is an axis of the vertical are flat too. suspect_s: counted seconds that a loss within strong motion may have raised
    (`suspect`), so that figures contain their time alone.
    """

    clipped: int
    absent_s: float
    filled_s: float
    flat_s: float
    dead_s: float = 0.0
    suspect_s: float = 0.0

    @property
    def missing_s(self) -> float:
        """All seconds without a true measurement."""
        return self.absent_s + self.filled_s + self.flat_s

    @property
    def lower_bound(self) -> bool:
        """Whether the figures are lower bounds."""
        return self.clipped > 0 or self.missing_s > 0.0 or self.suspect_s > 0.0

    @property
    def mean_lower_bound(self) -> bool:
        """Whether means are lower bounds: by clipped, flat or suspect samples, not by missing ones."""
        return self.clipped > 0 or self.flat_s > 0.0 or self.suspect_s > 0.0

    def with_suspect(self) -> Losses:
        """The losses of a figure that contains suspect samples."""
        return self._replace(suspect_s=0.0)

    def since(self, earlier: Losses) -> Losses:
        """The losses after an earlier state."""
        absent_s = max(0.0, self.absent_s - earlier.absent_s)  # a gap is withdrawn when leapt stamps return
        return Losses(
            self.clipped - earlier.clipped, absent_s, self.filled_s - earlier.filled_s, self.flat_s - earlier.flat_s,
            self.dead_s - earlier.dead_s, self.suspect_s - earlier.suspect_s,
        )  # fmt: skip

    def plus(self, other: Losses) -> Losses:
        """The sum of both."""
        return Losses(
            self.clipped + other.clipped, self.absent_s + other.absent_s, self.filled_s + other.filled_s,
            self.flat_s + other.flat_s, self.dead_s + other.dead_s, self.suspect_s + other.suspect_s,
        )  # fmt: skip


NO_LOSSES: Final = Losses(0, 0.0, 0.0, 0.0)
