"""Conditioning: one sensor's raw stamps and samples become evenly spaced, levelled, gravity-free, low-passed ones.

The same numbers for any cut into blocks. Causal for live and replay: the low-pass's group delay at 0 Hz is subtracted
from the stamps. Zero-phase for identification: a run is filtered at its end, without delay.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Final, Literal

import numpy as np

from biodyn_core.base.arrays import Floats, Integers
from biodyn_core.base.errors import InputError
from biodyn_core.base.sampling_rate import MAX_RATE_HZ, MIN_RATE_HZ, RATE_TOLERANCE
from biodyn_core.base.segments import HEAD, SEAT
from biodyn_core.conditioning.conditioned import Block, SensorStatus, lost_samples
from biodyn_core.conditioning.conditioning_settings import ConditioningSettings
from biodyn_core.conditioning.gravity import Gravity
from biodyn_core.conditioning.low_pass import group_delay_s, low_pass_sections, reach, zero_phase
from biodyn_core.conditioning.rails import Clipping
from biodyn_core.conditioning.rest import Rest
from biodyn_core.conditioning.rest_search import RestSearch
from biodyn_core.conditioning.runs import Runs
from biodyn_core.conditioning.sensor_warnings import clock_warnings, gravity_warnings, repeated_reading_warnings
from biodyn_core.conditioning.tilt import UP, Vector, gravity_and_vertical, rotation_to_vertical
from biodyn_core.kernels import rails
from biodyn_core.kernels import sensor as kernel
from biodyn_core.kernels.compiling import views

Mode = Literal["causal", "zero_phase", "survey", "rest"]
"""The output: causal or zero-phase blocks, or none.

"survey" gives the status of a sensor of any rate alone, "rest" the rest alone at which a causal path would begin.
"""

RATE_PER_CUTOFF: Final = 2.5
CLOCK_TIME_CONSTANT_S: Final = 5.0
"""Of the loop that tracks a sensor's clock: slow enough to average jitter, fast enough for any drift of a quartz."""

LEAST_SHARE: Final = 0.1
"""An axis within 6 degrees of the horizontal has less than this share in the vertical, and no part in its figures."""

SettingsOf = ConditioningSettings | Mapping[str, ConditioningSettings] | None
"""Settings of all sensors, or by the name of each; a sensor without an entry has the defaults."""


_NO_SAMPLES: Final = np.empty(0, dtype=np.int64), np.empty((0, 3))

_Columns = tuple[Integers, Floats, Floats, Floats]
"""Stamps (n,) ns, times (n,) s, levelled (n, 3) and low-passed m/s^2."""

_Buffers = tuple[Integers, Floats, Floats, Floats, Floats, Integers]
"""The same, raw readings (n, 3) m/s^2, and the index (n,) of each sample, -1 where interpolated."""


def settings_for(sensor: str, conditioning: SettingsOf) -> ConditioningSettings | None:
    """The settings of one sensor."""
    return conditioning.get(sensor) if isinstance(conditioning, Mapping) else conditioning


class Conditioner:
    """One sensor: clock, gaps, vertical and gravity, low-pass. `push` raw samples, get `Block`s, `finish` at the end.

    vertical (3,): up in the sensor's axes, if not determined at rest; gravity is then the mean along it.
    gravity: the mean reading at rest, if it is known before the first sample, as offline.

    rest: the rest of gravity and clock, None while it is searched for.
    """

    def __init__(
        self,
        sensor: str,
        settings: ConditioningSettings | None = None,
        mode: Mode = "causal",
        vertical: Vector | None = None,
        gravity: Gravity | None = None,
    ) -> None:
        self.sensor = sensor
        self.settings = settings or ConditioningSettings()
        self.mode = mode
        if mode == "zero_phase" and self.settings.gravity_tracker_s is not None:
            raise InputError("gravity_tracker_s is causal: leave it out with zero-phase filtering")
        if vertical is not None and not 0.0 < math.hypot(*vertical) < math.inf:
            raise InputError(
                f"{sensor}: vertical {vertical} is not a direction: give three finite numbers, not all zero"
            )
        self.delay_s = 0.0
        self._given_vertical = vertical
        # Rest at the start is searched for as live, so that both give the same numbers.
        self.gravity = None if gravity is None or gravity.origin == "begin" else gravity
        self._search = RestSearch(self.settings, self.gravity is not None, self._begin)
        self.rest: Rest | None = None
        self._known_from_ns: int | None = None
        self._state = np.zeros(kernel.STATE_SIZE)
        self._counts = np.zeros(kernel.COUNT_SIZE, dtype=np.int64)
        self._rails = np.zeros(rails.STATE_SIZE)
        self._at_extremes = np.zeros(rails.COUNT_SIZE, dtype=np.int64)
        self._deferred: tuple[Integers, Floats] | None = None
        self._run_blocks: list[Block] = []
        self._rejected_in_a_row = 0
        self.runs = Runs()
        self._run_epoch_ns = 0

    def begin_known(self, rest: Rest, stamp_ns: int) -> None:
        """Begin at a stamp with the gravity, vertical and clock of an earlier rest.

        Raises InputError where they do not fit the settings.
        """
        begun = dataclasses.replace(rest, epoch_ns=stamp_ns, last_time_s=0.0)
        self._start(begun)
        # As after a gap: the first sample is accepted at any stamp.
        self._state[kernel.TIME], self._state[kernel.LAST_STAMP] = math.nan, -math.inf
        self.rest, self._run_epoch_ns, self._known_from_ns = begun, stamp_ns, stamp_ns

    @property
    def begins_at_rest(self) -> bool:
        """Whether its first conditioned samples follow a rest, and not motion with known or averaged gravity."""
        return self.rest is not None and self._known_from_ns is None and not self.rest.in_motion

    # --- in and out --------------------------------------------------------------------------------------------------

    def push(self, stamps_ns: Integers, samples_mps2: Floats) -> list[Block]:
        """Condition raw specific force (n, 3) m/s^2 with header stamps (n,) ns, in order of arrival."""
        if stamps_ns.shape[0] == 0:
            return []
        # Copies: arrays of messages may be read-only or strided, and kernels are compiled again for each such kind.
        stamps_ns = np.array(stamps_ns, dtype=np.int64, order="C")
        samples_mps2 = np.array(samples_mps2, dtype=np.float64, order="C")
        if self.rest is None:
            found = self._search.push(stamps_ns, samples_mps2)
            self._count_searched()
            if found is None:
                return []
            stamps_ns, samples_mps2 = found
        return self._condition(stamps_ns, samples_mps2, final=False)

    def finish(self) -> list[Block]:
        """Return the remaining blocks: of a sample without a successor, and of the last run of a zero-phase sensor."""
        left = _NO_SAMPLES
        if self.rest is None:
            left = self._search.finish() or _NO_SAMPLES
            self._count_searched()
        if self.rest is None:
            return []
        return self._condition(*left, final=True) + self._filtered_run()

    def _count_searched(self) -> None:
        """Count what the search for rest rejected; the kernel, which has not read a sample yet, adds to it."""
        search = self._search
        self._counts[kernel.UNSET], self._counts[kernel.NON_FINITE] = search.unset, search.non_finite
        self._counts[kernel.DUPLICATE] = search.duplicate

    @property
    def rate_hz(self) -> float:
        """Sampling rate of the filters' design; known after rest."""
        assert self.rest is not None
        return 1.0 / self.rest.period_s

    @property
    def first_ns(self) -> int | None:
        """Stamp of the first sample, or of the start with a known rest; None before."""
        return self._search.first_ns if self._known_from_ns is None else self._known_from_ns

    @property
    def skipped(self) -> int:
        """Number of samples before the conditioned ones, the last one at rest included."""
        return self._search.skipped

    def zero_phase(self, values: Floats) -> Floats:
        """Low-pass a whole run (n, ...) like a zero-phase sensor's vertical; not before rest."""
        return zero_phase(self._sos, values)

    def reach(self, share: float) -> int:
        """Number of samples to either side beyond which the low-pass leaves less than a share; not before rest."""
        return reach(self._sos, share)

    @property
    def fault(self) -> str | None:
        """Why there are no blocks, in one line; None without a fault."""
        fault = self._search.fault if self.rest is None else None
        return fault and f"{self.sensor}: {fault}"

    @property
    def _set_back(self) -> int:
        """Samples that were late in a row, the present ones included."""
        now = int(self._counts[kernel.LATE_IN_A_ROW])
        return int(self._counts[kernel.SET_BACK]) + (now if now >= kernel.LEAP_CONFIRMED_BY else 0)

    @property
    def _unusable_s(self) -> float:
        """Time of the rejected samples since the last accepted one; 0 while it is too short for a gap.

        Samples count as time, because their stamps may be wrong. Samples of a clock that was set back count there.
        """
        if self.rest is None:
            return 0.0
        rejected = self._rejected_in_a_row - int(self._counts[kernel.LATE_IN_A_ROW])
        period_s = self.rest.period_s
        return rejected * period_s if (rejected + 1) * period_s > self._state[kernel.MAX_GAP] else 0.0

    @property
    def newest_ns(self) -> int | None:
        """Stamp of the newest accepted sample; None before gravity is known and right after time jumped back."""
        newest_s = float(self._state[kernel.LAST_STAMP])
        if self.rest is None or not math.isfinite(newest_s):
            return None
        return self._run_epoch_ns + round(newest_s * 1e9)

    def clipping(self) -> Clipping:
        """The clipped samples so far."""
        return Clipping.of(int(self._counts[kernel.CLIPPED]), self._rails, self._at_extremes)

    def status(self) -> SensorStatus:
        """The state so far."""
        counts, clipping, search = [int(v) for v in self._counts], self.clipping(), self._search
        known = self.rest is not None
        period_s = self.rest.period_s if self.rest else 0.0
        return SensorStatus(
            rate_hz=1.0 / float(self._state[kernel.PERIOD]) if known else None,
            period_s=period_s,
            jitter_s=float(self._state[kernel.JITTER]) if known else None,
            gravity_mps2=self._gravity_mps2 if known else None,
            vertical=self._vertical if known else None,
            filter_delay_s=self.delay_s if known else None,
            accepted=counts[kernel.ACCEPTED],
            unset=counts[kernel.UNSET],
            non_finite=counts[kernel.NON_FINITE],
            duplicate=counts[kernel.DUPLICATE],
            late=counts[kernel.LATE],
            stray=counts[kernel.STRAY],
            filled=counts[kernel.FILLED],
            flat=counts[kernel.FLAT],
            dead=counts[kernel.DEAD],
            clipped=clipping.total,
            runs=self.runs.count,
            run_s=counts[kernel.IN_RUN] * period_s if self.runs.count else None,
            uncounted_s=search.uncounted * period_s,
            unrested_s=search.unrested(self.rest) * period_s,
            set_back_s=self._set_back * period_s,
            gap_s=self.runs.gap_s,
            unusable_s=self._unusable_s,
            warnings=tuple(self._warnings(clipping)),
            fault=self.fault,
            waiting=None if known else search.reason(),
        )

    # --- begin -------------------------------------------------------------------------------------------------------

    def _begin(self, rest: Rest) -> None:
        """Begin after a rest, or with known gravity at the first sample of the clock."""
        if self.gravity is None:
            self._start(rest)
            self.rest, self._run_epoch_ns = rest, rest.epoch_ns
        else:
            known = dataclasses.replace(rest, mean_mps2=self.gravity.mean_mps2, in_motion=False)
            self.begin_known(known, rest.epoch_ns)

    def _start(self, rest: Rest) -> None:
        """Design the filters for the rate found; they start in steady state: zero, without gravity."""
        rate_hz, settings, s = 1.0 / rest.period_s, self.settings, self._state
        self._check_rate(rate_hz)
        self._gravity_mps2, self._vertical = gravity_and_vertical(rest.mean_mps2, self._given_vertical)
        if self._vertical is None and self.mode != "survey":
            raise InputError(
                f"at rest it reads {self._gravity_mps2:.2f} m/s^2: without gravity the vertical is unknown (REP-145):"
                " give it with the parameter vertical"
            )
        s[kernel.TIME] = s[kernel.LAST_STAMP] = s[kernel.FLAT_SINCE] = rest.last_time_s
        s[kernel.PERIOD] = s[kernel.NOMINAL] = rest.period_s
        s[kernel.JITTER] = rest.jitter_s
        s[kernel.LAST : kernel.LAST + 3] = rest.last_mps2
        s[kernel.AT_CHANGE : kernel.LEAST_CHANGE] = np.tile(rest.last_mps2, 3)
        s[kernel.LEAST_CHANGE] = math.inf
        s[kernel.AXIS_PART : kernel.AT_CHANGE] = self._parts_of_axes()
        s[kernel.ROTATION : kernel.LOW_PASS] = rotation_to_vertical(np.array(self._vertical or UP)).ravel()
        turns = CLOCK_TIME_CONSTANT_S * rate_hz
        tracker_s = settings.gravity_tracker_s
        s[kernel.MAX_GAP] = max(settings.max_gap_s, 1.5 * rest.period_s)
        s[kernel.FLAT_AFTER], s[kernel.SATURATION] = settings.flat_s, settings.saturation_mps2
        s[kernel.GAIN_TIME], s[kernel.GAIN_PERIOD] = 2.0 / turns, 1.0 / turns**2
        s[kernel.COARSE], s[kernel.AT_REST : kernel.BEFORE] = rest.coarse, rest.mean_mps2
        s[kernel.TRACKER_GAIN] = rest.period_s / tracker_s if tracker_s else 0.0
        self._counts[kernel.TRACKED] = self._counts[kernel.IN_RUN] = rest.samples
        self._max_fill = int(s[kernel.MAX_GAP] / (0.98 * rest.period_s)) + 2
        self._single_buffers = _new_buffers(1, self._max_fill)
        self._sos = np.zeros((kernel.SECTIONS, 6))
        self.delay_s = 0.0
        if self.mode in ("causal", "zero_phase"):
            self._sos = low_pass_sections(settings.cutoff_hz, rate_hz)
        if self.mode == "causal":
            s[kernel.LOW_PASS : kernel.LOW_PASS_STATE] = self._sos.ravel()
            self.delay_s = group_delay_s(self._sos, rate_hz)

    def _parts_of_axes(self) -> list[float]:
        """The part of each axis in the figures: exposure needs the horizontal axes of the seat, HIC of the head."""
        across = kernel.IN_HORIZONTAL if self.sensor in (SEAT, HEAD) else kernel.NO_PART
        return [kernel.IN_VERTICAL if abs(share) >= LEAST_SHARE else across for share in self._vertical or UP]

    @property
    def _least_rate_hz(self) -> float:
        return max(MIN_RATE_HZ, RATE_PER_CUTOFF * self.settings.cutoff_hz)

    def _check_rate(self, rate_hz: float) -> None:
        least = self._least_rate_hz
        lowest_hz, highest_hz = least * (1.0 - RATE_TOLERANCE), MAX_RATE_HZ * (1.0 + RATE_TOLERANCE)
        if self.mode != "survey" and not lowest_hz <= rate_hz <= highest_hz:
            raise InputError(f"a rate of {rate_hz:.4g} Hz does not fit, {least:g} to {MAX_RATE_HZ:g} Hz are needed")

    def _warnings(self, clipping: Clipping) -> list[str]:
        """What is wrong with the sensor, one line each."""
        railing = clipping.warning(self.settings.saturation_mps2)
        lines = [railing] if railing else []
        if self.rest is None:
            return lines
        lines += gravity_warnings(self._gravity_mps2, self.rest, self.gravity, self._given_vertical is not None)
        period_s, jitter_s = self._state[[kernel.PERIOD, kernel.JITTER]].tolist()
        lines += clock_warnings(self.rest, period_s, jitter_s)
        readings, regular, regular_sent = self._counts[[kernel.READINGS, kernel.REGULAR, kernel.REGULAR_SENT]].tolist()
        return lines + repeated_reading_warnings(readings, regular, regular_sent, self.rate_hz, self._least_rate_hz)

    # --- runs --------------------------------------------------------------------------------------------------------

    def _condition(self, stamps_ns: Integers, samples: Floats, final: bool) -> list[Block]:
        if self.mode == "rest":
            return []
        if self._deferred is not None:
            stamps_ns = np.concatenate([self._deferred[0], stamps_ns])
            samples = np.concatenate([self._deferred[1], samples])
            self._deferred = None
        blocks: list[Block] = []
        done, n = 0, stamps_ns.shape[0]
        while done < n:
            used, block, why = self._advance(stamps_ns[done:], samples[done:], final)
            done += used
            if block is not None:
                blocks += self._emitted(block)
            if why == kernel.UNDECIDED:
                self._deferred = stamps_ns[done:], samples[done:]
                break
            if why == kernel.NEW_RUN:
                blocks += self._end_run(int(stamps_ns[done]))
        return blocks

    def _advance(self, stamps_ns: Integers, samples: Floats, final: bool) -> tuple[int, Block | None, int]:
        """One call of the kernel: (samples consumed, block written, reason of its stop)."""
        assert self.rest is not None
        epoch_ns, is_single = self._run_epoch_ns, stamps_ns.shape[0] == 1
        filled_before = self._counts.item(kernel.FILLED)
        buffers = self._single_buffers if is_single else _new_buffers(stamps_ns.shape[0], self._max_fill)
        if self.mode == "survey":
            used, written, why = self._survey(stamps_ns, samples, final, buffers)
        else:
            used, written, why = kernel.condition(
                stamps_ns, samples, epoch_ns, round(self.delay_s * 1e9), final, self._state, self._counts, *buffers
            )  # fmt: skip
        stamps, times, levelled, low_passed, raw, source = buffers
        # The last sample written is the last accepted one.
        self._rejected_in_a_row = used - 1 - source.item(written - 1) if written else self._rejected_in_a_row + used
        if not written:
            return used, None, why
        if self._state.item(kernel.LARGEST) >= rails.LEAST_MPS2:
            self._find_rails(raw[:written], source)
        begins_ns, ends_ns = epoch_ns + round(times.item(0) * 1e9), epoch_ns + round(times.item(written - 1) * 1e9)
        begins_run, gap_s = self.runs.add(begins_ns, ends_ns, 1.0 / self.rate_hz)
        shift_s = (epoch_ns - self.rest.epoch_ns) * 1e-9 + self.runs.lap_s - self.delay_s
        rows = stamps[:written], times[:written] + shift_s, levelled[:written], low_passed[:written, 0]
        lost = lost_samples(source[:written]) if self._counts.item(kernel.FILLED) > filled_before else None
        block = Block(
            *(_copied(rows) if is_single else rows), begins_run, gap_s, self.rest.epoch_ns, self.rate_hz,
            self.settings.cutoff_hz, lost,
        )  # fmt: skip
        return used, block, why

    def _survey(self, stamps_ns: Integers, samples: Floats, final: bool, buffers: _Buffers) -> tuple[int, int, int]:
        """The kernel up to its clock, so that the rest is not compiled; of `buffers` times, raw and source alone."""
        _, times, _, _, raw, source = buffers
        given = views(stamps_ns, samples, self._state, self._counts, times, raw, source)
        stamps, read, state, counts, *written = given
        return kernel.regularise(stamps, read, self._run_epoch_ns, final, state, counts, *written)

    def _find_rails(self, raw_mps2: Floats, source: Integers) -> None:
        s = self._state
        samples, places, before = views(raw_mps2, source, s[kernel.BEFORE : kernel.JOINED])
        joined, limit_mps2 = s.item(kernel.JOINED) > 0.0, s.item(kernel.SATURATION)
        rows, counts = views(self._rails, self._at_extremes)
        rails.find_rails(samples, places, before, joined, limit_mps2, rows, counts)

    def _end_run(self, next_ns: int) -> list[Block]:
        """End the run: filters restart, because nothing integrates across a break."""
        blocks = self._filtered_run()
        self._state[kernel.LOW_PASS_STATE : kernel.MAX_GAP] = 0.0
        # Seconds since each run's first stamp: since an earlier epoch they would be too coarse for a rate.
        self._run_epoch_ns = next_ns
        self.runs.end(next_ns, 1.0 / self.rate_hz, self._rejected_in_a_row / self.rate_hz)
        return blocks

    def _emitted(self, block: Block) -> list[Block]:
        if self.mode == "causal":
            return [block]
        if self.mode == "zero_phase":
            self._run_blocks.append(block)
        return []

    def _filtered_run(self) -> list[Block]:
        """The run that has ended, filtered forward and backward."""
        if not self._run_blocks:
            return []
        stamps, times, levelled = (np.concatenate([block[k] for block in self._run_blocks]) for k in range(3))
        run = self._run_blocks[0]._replace(
            stamps_ns=stamps,
            time_s=times,
            levelled_mps2=levelled,
            low_passed_mps2=self.zero_phase(levelled[:, 2]),
            lost=np.concatenate([block.losses for block in self._run_blocks]),
        )
        self._run_blocks = []
        return [run]


def _new_buffers(samples: int, max_fill: int) -> _Buffers:
    """Arrays that the kernel writes to; blocks are views of them."""
    size = samples + max_fill + 2
    stamps, source = np.empty(size, dtype=np.int64), np.empty(size, dtype=np.int64)
    return stamps, np.empty(size), np.empty((size, 3)), np.empty((size, 1)), np.empty((size, 3)), source


def _copied(rows: _Columns) -> _Columns:
    """Copies, so that a live block of one row does not keep the buffers, which are used again."""
    stamps, times, levelled, low_passed = rows
    return stamps.copy(), times.copy(), levelled.copy(), low_passed.copy()
