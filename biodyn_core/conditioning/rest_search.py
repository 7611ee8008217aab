"""Rest search: the first samples of one sensor, until its gravity and clock are known."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Floats, Integers
from biodyn_core.base.errors import InputError
from biodyn_core.conditioning.conditioning_settings import ConditioningSettings
from biodyn_core.conditioning.gravity import IDLING_MPS2
from biodyn_core.conditioning.rest import Rest, RestWindow, is_plausible
from biodyn_core.kernels.sensor import IMPLAUSIBLE

Samples = tuple[Integers, Floats]

UNSET: Final = "stamps are zero: set header stamps in the driver; log times (--time log) help if these are set"
MAX_UNSET: Final = 20
"""More stamps of zero than this, and more than other stamps, come from a driver that sets none."""


class RestSearch:
    """`push` samples until they contain a rest, or with known gravity until they show the clock.

    begin: called with each rest found; its InputError is a fault, and the search continues, as after a repair.
    first_ns: stamp of the first sample, None with known gravity. skipped: samples before the conditioned ones, rest
    included; uncounted: the same in sampling periods. unset, non_finite, duplicate: those of them with a stamp of zero,
    without a possible reading, or with stamp and reading of an earlier one (only once the clock is known, because
    samples may share a stamp). No stamp is late or stray, because there is no clock to judge it by.
    """

    def __init__(self, settings: ConditioningSettings, gravity_known: bool, begin: Callable[[Rest], None]) -> None:
        self._settings, self._gravity_known, self._begin = settings, gravity_known, begin
        self._implausible_mps2 = IMPLAUSIBLE * settings.saturation_mps2
        self._window = RestWindow(
            settings.rest_s, settings.rest_patience_s, settings.rest_rms_mps2, settings.max_gap_s,
            self._implausible_mps2, clock_only=gravity_known,
        )  # fmt: skip
        self._early: list[Samples] = []
        self._fault: str | None = None
        self.first_ns: int | None = None
        self.skipped = self.uncounted = self.unset = self.non_finite = self.duplicate = 0

    def push(self, stamps_ns: Integers, samples: Floats) -> Samples | None:
        """Add samples (n, 3) with stamps (n,) ns; return those to condition once the search has ended, else None."""
        is_set = stamps_ns != 0
        self._window.add(stamps_ns[is_set], samples[is_set])
        if self._gravity_known:
            self._early.append((stamps_ns, samples))
            return self._with_clock() if self._found() else None
        if self.first_ns is None and is_set.any():
            self.first_ns = int(stamps_ns[is_set.argmax()])
        found = self._found()
        begin = int(np.flatnonzero(is_set)[-self._window.clear()]) if found else len(stamps_ns)
        self._count_rejected(stamps_ns[:begin], samples[:begin])
        self.skipped += begin
        return (stamps_ns[begin:], samples[begin:]) if found else None

    def finish(self) -> Samples | None:
        """End the record: with known gravity return the samples to condition, if they show a clock."""
        if not self._gravity_known:
            return None
        if self._found(final=True):
            return self._with_clock()
        self.unset = self.non_finite = 0
        for stamps_ns, samples in self._early:
            self._count_rejected(stamps_ns, samples)
        return None

    def _count_rejected(self, stamps_ns: Integers, samples: Floats) -> None:
        """Count samples (n, 3) that are not conditioned later, as conditioning counts them."""
        is_set = stamps_ns != 0
        self.unset += int((~is_set).sum())
        self.non_finite += int((is_set & ~is_plausible(samples, self._implausible_mps2)).sum())

    def _found(self, final: bool = False) -> bool:
        while True:
            try:
                rest = self._window.conclude() if final else self._window.find()
                if rest is None:
                    return False
                self._begin(rest)
                break
            except InputError as error:
                self._fault = str(error)
                if final:
                    return False
        self._fault = None
        self.duplicate = 0 if rest.coarse else self._window.repeated
        self.uncounted = self._window.before if self._gravity_known else self._window.dropped
        if not self._gravity_known:
            # By the count of samples, because the first stamp may be a stray one.
            waited_s = (self.uncounted - 1) * rest.period_s
            self.first_ns = rest.epoch_ns + round(1e9 * (rest.last_time_s - waited_s))
        return True

    def _with_clock(self) -> Samples:
        """The samples from the first one of the clock on; a break separates those before it."""
        stamps_ns, samples = (np.concatenate(parts) for parts in zip(*self._early, strict=True))
        self._early = []
        self._window.clear()
        set_at = np.flatnonzero(stamps_ns != 0)
        self.skipped = int(set_at[min(self.uncounted, set_at.size - 1)])
        self.unset = self.non_finite = 0
        self._count_rejected(stamps_ns[: self.skipped], samples[: self.skipped])
        return stamps_ns[self.skipped :], samples[self.skipped :]

    @property
    def fault(self) -> str | None:
        """Why no rest can be found, in one line; None without a fault."""
        return UNSET if self.unset >= MAX_UNSET and self.unset > self._window.collected else self._fault

    def reason(self) -> str:
        """Reason that rest is not found yet, and the remedy, in one line."""
        s, moving_mps2, waited_s = self._settings, self._window.moving_rms_mps2, self._window.waited_s
        if moving_mps2 is None and waited_s >= s.rest_s:
            return f"gravity needs {s.rest_s:g} s of readings (rest_s): none of the last {waited_s:.2g} s can be used"
        if moving_mps2 is None or waited_s < s.rest_s:
            return f"gravity needs {s.rest_s:g} s of samples (rest_s), {waited_s:.2g} s have arrived"
        idling = f", or with an engine that idles set rest_rms_mps2 above {moving_mps2:.3f}"
        return (
            f"waiting for rest: the sensor moves by {moving_mps2:.3f} m/s^2 rms, {s.rest_rms_mps2:g} is allowed: hold"
            f" still{idling if moving_mps2 <= IDLING_MPS2 else ''}; after {s.rest_patience_s:g} s (rest_patience_s)"
            f" motion is averaged, {waited_s:.1f} s have passed"
        )

    def unrested(self, rest: Rest | None) -> int:
        """Sampling periods before the window at rest; all uncounted ones where there is none."""
        if rest is None or rest.in_motion or self._gravity_known:
            return self.uncounted
        return max(0, self.uncounted - round(rest.last_time_s / rest.period_s) - 1)
