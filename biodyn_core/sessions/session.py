"""Session: `push` the samples of six sensors, `finish` for its rests, events and faults.

A sensor is conditioned as in a causal replay. Memory is that of sums over short intervals, 0.3 MB for a minute of all
sensors.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Floats, Integers
from biodyn_core.base.segments import SEAT, SENSORS
from biodyn_core.base.wording import counted
from biodyn_core.body.model import WARM_UP_S
from biodyn_core.conditioning.conditioner import Conditioner, SettingsOf, settings_for
from biodyn_core.conditioning.gravity import IDLING_MPS2, SAME_REST_MPS2, Gravity, angle_deg
from biodyn_core.conditioning.tilt import LEAST_GRAVITY_MPS2, Vector
from biodyn_core.recording.flags import stretches
from biodyn_core.sessions.cases import named
from biodyn_core.sessions.digest import (
    COARSE_S,
    FINE_S,
    LOW_PASSED,
    WEIGHTED,
    SeatDigest,
    SensorDigest,
    repeats_in,
)
from biodyn_core.sessions.finding import Window, find, level_of, rms_of
from biodyn_core.sessions.findings import Event, Fault, Findings, Rest, Shock, Timeline
from biodyn_core.sessions.relative_drift import PhaseMeter, RelativeDrift, block_extent
from biodyn_core.sessions.repeats import LEAST_SHARE, unsure
from biodyn_core.sessions.rests import Beside, beside
from biodyn_core.sessions.settings import SessionSettings

MISSING_SHARE: Final = 0.02
"""Share of an event's samples whose loss is stated."""

Span = tuple[float, float]
"""Begin and end, s."""

LATEST: Final = 3000
"""Intervals of 20 ms, a minute, by which the samples of a sensor may come after those of the seat."""


class Session:
    """`push` raw samples in order of arrival, then `finish`; the same results for any cut into blocks.

    epoch_ns: stamp of the seat's first sample, from which times are counted.
    """

    def __init__(
        self,
        epoch_ns: int,
        conditioning: SettingsOf = None,
        settings: SessionSettings | None = None,
        verticals: Mapping[str, Vector] | None = None,
        gravity: Mapping[str, Gravity] | None = None,
    ) -> None:
        self.settings, self._epoch_ns = settings or SessionSettings(), epoch_ns
        given, known = verticals or {}, gravity or {}
        conditioners = {
            name: Conditioner(name, settings_for(name, conditioning), "causal", given.get(name), known.get(name))
            for name in SENSORS
        }
        self._seat = SeatDigest(conditioners[SEAT], epoch_ns, self.settings)
        self._digests: dict[str, SensorDigest] = {
            name: self._seat if name == SEAT else SensorDigest(one, epoch_ns, self.settings)
            for name, one in conditioners.items()
        }
        self._phases = {name: PhaseMeter(FINE_S, self.settings.steady_level_mps2) for name in SENSORS if name != SEAT}
        self._block = 0

    def push(self, sensor: str, stamps_ns: Integers, samples_mps2: Floats) -> None:
        """Take raw specific force (n, 3) m/s^2 of one sensor with its stamps (n,) ns; InputError as `SensorDigest`."""
        digest = self._digests[sensor]
        over = (np.abs(samples_mps2) >= digest.conditioner.settings.saturation_mps2).any(axis=1)
        if over.any():
            digest.add_clipped(stamps_ns[over])
        digest.push(digest.conditioner.push(stamps_ns, samples_mps2))
        if digest is self._seat:
            self._add_phases(final=False)

    def finish(self) -> Findings:
        """End the session; without rests and events where the seat gives no samples."""
        for digest in self._digests.values():
            digest.push(digest.conditioner.finish())
            digest.finish()
        self._add_phases(final=True)
        fine = self._seat.fine
        found = find(self._seat.coarse, fine, self.settings, self._beside_the_seat())
        rests = self._rests(found.rests)
        seconds = self._seconds()
        noticeable = dict(self._noticeable(seconds))
        sigmas = self.settings.drift_sigmas
        drifts = {name: one for name, one in noticeable.items() if abs(one.ppm) > sigmas * one.error_ppm}
        faults = tuple(fault for name in self._present() for fault in self._faults(name, seconds))
        there = fine.counts > 0.0
        rms = np.sqrt(fine.sums[:, LOW_PASSED] / np.where(there, fine.counts, np.nan))
        return Findings(
            seconds=seconds,
            rests=rests,
            events=named([self._event(window, rests) for window in found.windows]),
            faults=faults,
            timeline=Timeline(fine.width_s, rms, np.where(there, fine.maxima[:, 0], np.nan)),
            waterfall=self._seat.waterfall(),
            drifts=drifts,
            statuses={name: digest.status() for name, digest in self._digests.items()},
            warnings=(
                *self._warnings(),
                *self._stuck_at_rest(rests),
                *_moved(rests, self.settings.moved_deg),
                *(_drift_line(name, drift, seconds, name in drifts) for name, drift in noticeable.items()),
                *found.left_out,
            ),
        )

    def _beside_the_seat(self) -> Beside | None:
        """What the other sensors show of the seat's rests; None without any."""
        count = self._seat.coarse.counts.size
        others = [self._digests[name].rms(count) for name in self._present() if name != SEAT]
        return beside(others, self.settings) if any(np.isfinite(rms).any() for rms in others) else None

    def _seconds(self) -> float:
        """The length of the session, by the seat."""
        return self._seat.fine.counts.size * self._seat.fine.width_s

    def _present(self) -> list[str]:
        """The sensors with samples."""
        return [name for name, digest in self._digests.items() if digest.coarse.counts.any()]

    def _rests(self, spans: Sequence[Span]) -> tuple[Rest, ...]:
        """The rests with the mean readings of the sensors that rest."""
        readings = {name: _readings_at_rest(digest, spans) for name, digest in self._digests.items()}
        return tuple(
            Rest(*span, {name: mean for name, means in readings.items() if (mean := means[at]) is not None})
            for at, span in enumerate(spans)
        )

    def _stuck_at_rest(self, rests: Sequence[Rest]) -> Iterator[str]:
        """A line for each sensor that repeats one reading in a rest."""
        for name in self._present():
            digest = self._digests[name]
            for rest in rests:
                span = rest.begin_s, rest.end_s
                where = f"the rest from {rest.begin_s:.0f} to {rest.end_s:.0f} s"
                if digest.stuck(*span).any():
                    yield f"{name}: repeats one reading in a part of {where}: its gravity leaves this part out"
                elif name not in rest.gravity_mps2 and _repeats(digest, span):
                    yield f"{name}: repeats one reading in {where}: its gravity is wrong if it was stuck"
                else:
                    continue
                break

    def _event(self, window: Window, rests: Sequence[Rest]) -> Event:
        begin_s, end_s, fine, s = window.begin_s, window.end_s, self._seat.fine, self.settings
        # Shocks in the warm-up of an event are none of its own.
        here = fine.extent(begin_s + (WARM_UP_S if window.groups else 0.0), end_s)
        peaks = fine.maxima[here, 0]
        return Event(
            name="",
            begin_s=begin_s,
            end_s=end_s,
            case={"train": s.train_case, "shock": s.shock_case, "steady": s.steady_case}[window.kind(s)],
            peak_mps2=float(peaks.max(initial=0.0)),
            peak_s=(here.start + int(peaks.argmax()) + 0.5) * FINE_S if peaks.size else begin_s,
            level_mps2=level_of(fine, begin_s, end_s),
            aw_mps2=rms_of(fine, WEIGHTED, begin_s, end_s),
            shocks=tuple(Shock(group.peak_s, group.peak_mps2) for group in window.groups),
            rest=_nearest(rests, begin_s, end_s, s.moved_deg),
            quality=tuple(self._quality(begin_s, end_s)),
        )

    def _quality(self, begin_s: float, end_s: float) -> Iterator[str]:
        """The faults of the present sensors between two times, a line each."""
        # A sensor that stops early has fewer intervals than the seat.
        here = self._seat.coarse.extent(begin_s, end_s)
        # The recording may end within its last interval.
        length_s = min(here.stop * COARSE_S, self._seconds()) - here.start * COARSE_S
        for name in self._present():
            digest = self._digests[name]
            expected = self._expected(name) * length_s / COARSE_S
            missing = 1.0 - digest.coarse.counts[here].sum() / max(expected, 1.0)
            if missing > MISSING_SHARE:
                yield f"{name}: {100.0 * missing:.0f} % missing"
            if clipped := int(digest.clipped.counts[digest.clipped.extent(begin_s, end_s)].sum()):
                yield f"{name}: {counted(clipped, 'sample')} clipped"
            if repeats_in(digest.coarse, here).any():
                yield f"{name}: stuck"

    def _expected(self, name: str) -> float:
        """The number of samples in an interval."""
        return COARSE_S * (self._digests[name].status().rate_hz or 0.0)

    def _faults(self, name: str, seconds: float) -> Iterator[Fault]:
        """The stretches without usable samples of a sensor."""
        digest, size = self._digests[name], int(seconds / COARSE_S)
        counts, clipped = np.zeros(size), np.zeros(size)
        for into, of in ((counts, digest.coarse.counts), (clipped, digest.clipped.counts)):
            shared = min(size, of.size)
            into[:shared] = of[:shared]
        stuck = np.zeros(size, dtype=np.bool_)
        stuck[: min(size, digest.coarse.counts.size)] = digest.repeats[:size]
        flags = {"missing": counts < 0.5 * self._expected(name), "clipped": clipped > 0.0, "stuck": stuck}
        for kind, flag in flags.items():
            for begin, end in stretches(flag):
                yield Fault(name, kind, begin * COARSE_S, end * COARSE_S)

    def _noticeable(self, seconds: float) -> Iterator[tuple[str, RelativeDrift]]:
        """The drift of each clock against the seat's that is above chance and changes times noticeably."""
        s = self.settings
        for name, meter in self._phases.items():
            found = meter.drift()
            if found is None or 1e3 * found.apart_s(seconds) <= s.drift_ms:
                continue
            if abs(found.ppm) > s.drift_sigmas * found.chance_ppm:
                yield name, found

    def _add_phases(self, final: bool) -> None:
        """Compare the sensors with the seat in the blocks that are complete, and forget their samples."""
        mean = self._seat.mean
        ends = [self._digests[name].mean.end for name in self._phases]
        # A sensor that is not there must not hold up the others.
        complete = min([mean.end - 1, *(max(end - 1, mean.end - LATEST) for end in ends)])
        while block_extent(self._block)[1] <= complete or (final and block_extent(self._block)[0] < mean.end):
            begin, end = block_extent(self._block)
            seat, of_seat = mean.means(begin, end)
            for name, meter in self._phases.items():
                sensor, of_sensor = self._digests[name].mean.means(begin, end)
                meter.add(self._block, seat, sensor, (of_seat > 0.0) & (of_sensor > 0.0))
            self._block += 1
            for digest in self._digests.values():
                digest.mean.drop(block_extent(self._block)[0])

    def _warnings(self) -> Iterator[str]:
        """Warnings about sensors, one line each."""
        for name, digest in self._digests.items():
            if not digest.coarse.counts.any():
                why = "its stamps are before the seat's: another clock; use --time log" if digest.is_earlier else ""
                yield f"{name}: {digest.conditioner.fault or digest.status().waiting or why or 'no samples'}"
            yield from (f"{name}: {line}" for line in digest.status().warnings)


def _drift_line(name: str, drift: RelativeDrift, seconds: float, is_sure: bool) -> str:
    """The drift of a clock and its effect, or why it is not corrected."""
    size = f"{drift.ppm:+.1f} ppm (error {drift.error_ppm:.1f})"
    apart = f"{1e3 * drift.apart_s(seconds):.1f} ms over the session"
    if is_sure:
        return f"{name}: its clock drifts by {size} against the seat's, {apart}: corrected where events are read"
    return (
        f"{name}: a drift of its clock by {size} against the seat's, {apart}, is not corrected: low and high"
        " frequencies disagree, as in a body that softens while the level rises"
    )


def _readings_at_rest(digest: SensorDigest, spans: Sequence[Span]) -> list[Vector | None]:
    """The mean reading of a sensor in each rest; None where it moves, is stuck, or reads no gravity."""
    found: list[Vector | None] = [None] * len(spans)
    for at, span in enumerate(spans):
        mean = digest.mean_reading(*span)
        if mean and math.hypot(*mean) >= LEAST_GRAVITY_MPS2 and digest.rms_about_mean(*span) <= IDLING_MPS2:
            found[at] = mean
    known = [at for at, mean in enumerate(found) if mean is not None]
    here = [digest.coarse.extent(*spans[at]) for at in known]
    means = np.array([found[at] for at in known], dtype=np.float64).reshape(-1, 3)
    extents = [(one.start, one.stop) for one in here]
    changing = (digest.coarse.counts > 0.0) & ~digest.repeats
    repeats = digest.repeats
    for at in known:
        repeats[digest.coarse.extent(*spans[at])] &= ~digest.stuck(*spans[at])  # these have no part in the means
    for at, is_unsure in zip(known, unsure(means, extents, repeats, changing, SAME_REST_MPS2), strict=True):
        if is_unsure:
            found[at] = None
    return found


def _repeats(digest: SensorDigest, span: Span) -> bool:
    """Whether a sensor repeats one reading in most of a rest, as far as it is not known to be stuck there."""
    here = digest.coarse.extent(*span)
    usable = ~digest.stuck(*span)
    return bool(usable.any() and repeats_in(digest.coarse, here)[usable].mean() > LEAST_SHARE)


def _level_rests(rests: Sequence[Rest], least_deg: float) -> list[int]:
    """The numbers of the rests for gravity: without one in which the seat tilts, against the rests before and after.

    Such a vehicle stands on a slope, or at a kerb. A sensor that was moved is tilted from then on.
    """

    def alike(one: Rest, other: Rest) -> bool:
        a, b = one.gravity_mps2.get(SEAT), other.gravity_mps2.get(SEAT)
        return a is None or b is None or angle_deg(a, b) <= least_deg

    def tilts(at: int) -> bool:
        if not 0 < at < len(rests) - 1:
            return False
        before, here, after = rests[at - 1 : at + 2]
        return alike(before, after) and not alike(before, here) and not alike(here, after)

    return [at for at in range(len(rests)) if not tilts(at)]


def _nearest(rests: Sequence[Rest], begin_s: float, end_s: float, least_deg: float) -> int | None:
    """The number of the rest that is nearest in time, of those for gravity."""
    numbers = _level_rests(rests, least_deg)
    distances = [max(rests[at].begin_s - end_s, begin_s - rests[at].end_s, 0.0) for at in numbers]
    return numbers[int(np.argmin(distances))] if distances else None


def _moved(rests: Sequence[Rest], least_deg: float) -> Iterator[str]:
    """A line for each sensor that is mounted otherwise in a rest than in its last one."""
    last: dict[str, Rest] = {}
    for at in _level_rests(rests, least_deg):
        rest = rests[at]
        turned_deg = {
            name: angle_deg(last[name].gravity_mps2[name], mean)
            for name, mean in rest.gravity_mps2.items()
            if name in last
        }
        times = {name: f"{last[name].begin_s:.0f} s and {rest.begin_s:.0f} s" for name in turned_deg}
        for name, deg in turned_deg.items():
            # All sensors turn with a vehicle that stands on a slope.
            if deg > least_deg and (name == SEAT or deg > least_deg + turned_deg.get(SEAT, 0.0)):
                cause = "does the vehicle stand on a slope, or was it moved?" if name == SEAT else "was it moved?"
                yield f"{name}: turned by {deg:.0f} deg between the rests at {times[name]}: {cause}"
        last |= dict.fromkeys(rest.gravity_mps2, rest)
