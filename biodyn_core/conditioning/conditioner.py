"""Conditioning: one sensor's raw stamps and samples become evenly spaced, levelled, gravity-free, low-passed ones.

The same numbers for any cut into blocks. Causal for live and replay: the low-pass's low-frequency group delay is taken
off the stamps. Zero-phase for identification: a run is answered once it has ended, and nothing is delayed.
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
from biodyn_core.base.segments import STANDARD_GRAVITY_MPS2
from biodyn_core.conditioning.conditioned import Block, SensorStatus
from biodyn_core.conditioning.conditioning_settings import ConditioningSettings
from biodyn_core.conditioning.gravity import IDLING_MPS2, Gravity, GravitySearch
from biodyn_core.conditioning.rails import Clipping
from biodyn_core.conditioning.rest import Rest, RestWindow
from biodyn_core.conditioning.runs import Runs
from biodyn_core.conditioning.tilt import UP, Vector, gravity_and_vertical, rotation_to_vertical
from biodyn_core.kernels import rails
from biodyn_core.kernels import sensor as kernel
from biodyn_core.kernels.compiling import views

Mode = Literal["causal", "zero_phase", "survey", "rest"]
"""What comes out: causal or zero-phase answers, or none at all.

With "survey" only the status of a sensor of any rate; with "rest" only whether, and when, a causal path begins.
"""

FILTER_ORDER: Final = 2 * kernel.SECTIONS
"""Butterworth low-pass of the paper, 5.2; zero-phase it runs forward and backward, -6 dB at the cut-off."""

RATE_PER_CUTOFF: Final = 2.5
CLOCK_TIME_CONSTANT_S: Final = 5.0
"""The loop that follows a sensor's clock: slow enough to average jitter, fast enough for any drift of a quartz."""

JITTER_TOLERATED: Final = 0.35
"""With more mean jitter than so many periods no stamp tells whether a sample was lost before it."""

GRAVITY_TOLERANCE: Final = 0.05
UNSET: Final = "header stamps are zero: use log time (--time log), or set them in the driver"
UNSET_TOLERATED: Final = 20
"""So many stamps of zero while rest is looked for, and more than others, are a driver that sets none."""

RATE_TOLERATED: Final = 0.0199
"""The tracked rate stays within 2 % of that at rest; one that comes this close is not followed."""

SettingsOf = ConditioningSettings | Mapping[str, ConditioningSettings] | None
"""Settings of all sensors, or of each by its name; of a sensor that is not named they are the defaults."""


_NONE_LEFT: Final = np.empty(0, dtype=np.int64), np.empty((0, 3))

_Answered = tuple[Integers, Floats, Floats, Floats]
"""Stamps (n,) ns, times (n,) s, levelled (n, 3) and low-passed m/s^2."""

_Rows = tuple[Integers, Floats, Floats, Floats, Floats, Integers]
"""The same, then raw readings (n, 3) m/s^2, and by index (n,) which sample each was, -1 where interpolated."""


def gravity_search(settings: ConditioningSettings | None, vertical: Vector | None) -> GravitySearch:
    """Search a record for rest as a sensor with these settings would take it."""
    s = settings or ConditioningSettings()
    implausible_mps2 = kernel.IMPLAUSIBLE * s.saturation_mps2
    return GravitySearch(s.rest_s, s.rest_rms_mps2, s.max_gap_s, implausible_mps2, vertical)


def settings_for(sensor: str, conditioning: SettingsOf) -> ConditioningSettings | None:
    """How one sensor is conditioned."""
    return conditioning.get(sensor) if isinstance(conditioning, Mapping) else conditioning


class Conditioner:
    """One sensor: clock, gaps, vertical and gravity, low-pass. `push` raw samples, get `Block`s, `finish` at the end.

    vertical (3,): where the sensor's axes see up, if rest is not to tell it; its gravity is then the mean along it.
    gravity: its mean reading, where that is known before the first sample, as offline: conditioning begins there.
    waited: how many samples came before those that are conditioned, the last one at rest included.
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
            raise InputError(f"{sensor}: vertical {vertical} is no direction: three finite numbers, not all zero")
        self.delay_s = 0.0
        self._given_vertical = vertical
        # Rest at the begin is found here as it is live, so that both give the same numbers.
        self.gravity = None if gravity is None or gravity.origin == "begin" else gravity
        self._fault: str | None = None
        self.first_ns: int | None = None
        self.waited = 0
        self._waiting = self._new_wait()
        self._rest: Rest | None = None
        self._uncounted = 0
        self._early: list[tuple[Integers, Floats]] = []
        self._state = np.zeros(kernel.STATE_SIZE)
        self._counts = np.zeros(kernel.COUNT_SIZE, dtype=np.int64)
        self._rails = np.zeros(rails.STATE_SIZE)
        self._at_extremes = np.zeros(rails.COUNT_SIZE, dtype=np.int64)
        self._undecided: tuple[Integers, Floats] | None = None
        self._held: list[Block] = []
        self.runs = Runs()
        self._run_epoch_ns = 0

    def begin_known(self, rest: Rest, stamp_ns: int) -> None:
        """Begin without rest, from a stamp on: gravity, vertical and clock are known from a run just before.

        Raises InputError where they do not fit the settings.
        """
        begun = dataclasses.replace(rest, epoch_ns=stamp_ns, last_time_s=0.0)
        self._start(begun)
        # As behind a gap: whatever comes first is accepted.
        self._state[kernel.TIME], self._state[kernel.LAST_STAMP] = math.nan, -math.inf
        self._rest, self._run_epoch_ns, self.first_ns = begun, stamp_ns, stamp_ns

    # --- in and out --------------------------------------------------------------------------------------------------

    def push(self, stamps_ns: Integers, samples_mps2: Floats) -> list[Block]:
        """Condition raw specific force (n, 3) m/s^2 with header stamps (n,) ns, in order of arrival."""
        if stamps_ns.shape[0] == 0:
            return []
        # Copies: what comes from a message may be read-only or strided, and each such kind would be compiled anew.
        stamps_ns = np.array(stamps_ns, dtype=np.int64, order="C")
        samples_mps2 = np.array(samples_mps2, dtype=np.float64, order="C")
        if self._rest is None:
            look = self._look_for_rest if self.gravity is None else self._look_for_clock
            found = look(stamps_ns, samples_mps2)
            if found is None:
                return []
            stamps_ns, samples_mps2 = found
        return self._condition(stamps_ns, samples_mps2, final=False)

    def finish(self) -> list[Block]:
        """Answer what still waits: a sample that nothing followed, and the last run of a zero-phase sensor."""
        left = _NONE_LEFT
        if self._rest is None and self.gravity is not None and self._found_rest(final=True):
            left = self._collected()
        if self._rest is None:
            return []
        return self._condition(*left, final=True) + self._filtered_run()

    @property
    def rate_hz(self) -> float:
        """Sampling rate the filters were designed for; known after rest."""
        assert self._rest is not None
        return 1.0 / self._rest.period_s

    @property
    def rest(self) -> Rest | None:
        """The rest that gravity and clock are taken from; None while it is looked for."""
        return self._rest

    def zero_phase(self, values: Floats) -> Floats:
        """Low-pass a whole run (n, ...) forward and backward, as a zero-phase sensor's vertical is; not before rest."""
        from scipy import signal  # half a second

        padding = min(3 * (2 * kernel.SECTIONS + 1), len(values) - 1)
        filtered: Floats = np.ascontiguousarray(signal.sosfiltfilt(self._sos, values, axis=0, padlen=padding))
        return filtered

    @property
    def fault(self) -> str | None:
        """Why it answers nothing, in one line."""
        unset = int(self._counts[kernel.UNSET])
        if self._rest is None and unset >= UNSET_TOLERATED and unset > self._waiting.collected:
            return f"{self.sensor}: {UNSET}"
        return self._fault

    @property
    def _unrested(self) -> int:
        """Samples that came before the window at rest; all of them where there was none."""
        rest = self._rest
        if rest is None or rest.in_motion or self.gravity is not None:
            return self._uncounted
        return max(0, self._uncounted - round(rest.last_time_s / rest.period_s) - 1)

    @property
    def _set_back(self) -> int:
        """Samples that were late behind each other, those of now included."""
        now = int(self._counts[kernel.LATE_IN_A_ROW])
        return int(self._counts[kernel.SET_BACK]) + (now if now >= kernel.LEAP_CONFIRMED_BY else 0)

    @property
    def newest_ns(self) -> int | None:
        """Stamp of the newest accepted sample; None before gravity is known and right after time jumped back."""
        newest_s = float(self._state[kernel.LAST_STAMP])
        if self._rest is None or not math.isfinite(newest_s):
            return None
        return self._run_epoch_ns + round(newest_s * 1e9)

    def clipping(self) -> Clipping:
        """What was clipped so far."""
        return Clipping.of(int(self._counts[kernel.CLIPPED]), self._rails, self._at_extremes)

    def status(self) -> SensorStatus:
        """What was seen so far."""
        counts, clipping = [int(v) for v in self._counts], self.clipping()
        known = self._rest is not None
        period_s = self._rest.period_s if self._rest else 0.0
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
            clipped=clipping.total,
            runs=self.runs.count,
            run_s=counts[kernel.IN_RUN] * period_s if self.runs.count else None,
            uncounted_s=self._uncounted * period_s,
            unrested_s=self._unrested * period_s,
            set_back_s=self._set_back * period_s,
            gap_s=self.runs.gap_s,
            warnings=tuple(self._warnings(clipping)),
            fault=self.fault,
            waiting=self._why_waiting(),
        )

    # --- rest --------------------------------------------------------------------------------------------------------

    def _new_wait(self) -> RestWindow:
        s = self.settings
        return RestWindow(
            s.rest_s, s.rest_patience_s, s.rest_rms_mps2, s.max_gap_s, kernel.IMPLAUSIBLE * s.saturation_mps2,
            clock_only=self.gravity is not None,
        )  # fmt: skip

    def _why_waiting(self) -> str | None:
        """Why gravity and rate are not known yet, and what helps, in one line; None once they are."""
        s, waiting = self.settings, self._waiting
        if self._rest is not None:
            return None
        moving_mps2, waited_s = waiting.moving_rms_mps2, waiting.waited_s
        if moving_mps2 is None or waited_s < s.rest_s:
            return f"gravity needs {s.rest_s:g} s of samples (rest_s), {waited_s:.2g} s have come"
        idling = f", or with an engine that idles set rest_rms_mps2 above {moving_mps2:.3f}"
        return (
            f"waiting for rest: the sensor moves by {moving_mps2:.3f} m/s^2 rms, {s.rest_rms_mps2:g} is allowed: hold"
            f" still{idling if moving_mps2 <= IDLING_MPS2 else ''}; after {s.rest_patience_s:g} s (rest_patience_s)"
            f" motion is averaged, {waited_s:.1f} s have passed"
        )

    def _look_for_rest(self, stamps_ns: Integers, samples: Floats) -> tuple[Integers, Floats] | None:
        """Collect until gravity is known; return the samples that come after it, or None while it is not.

        A fault is told and waiting goes on: a sensor that is mended meanwhile is believed.
        """
        is_set = stamps_ns != 0
        if self.first_ns is None and is_set.any():
            self.first_ns = int(stamps_ns[is_set.argmax()])
        self._waiting.add(stamps_ns[is_set], samples[is_set])
        found = self._found_rest()
        begin = int(np.flatnonzero(is_set)[-self._waiting.end()]) if found else len(stamps_ns)
        self._counts[kernel.UNSET] += int((~is_set[:begin]).sum())
        self.waited += begin
        return (stamps_ns[begin:], samples[begin:]) if found else None

    def _look_for_clock(self, stamps_ns: Integers, samples: Floats) -> tuple[Integers, Floats] | None:
        """With known gravity: collect until the clock is known; return all samples that came, or None until then."""
        self._early.append((stamps_ns, samples))
        is_set = stamps_ns != 0
        self._waiting.add(stamps_ns[is_set], samples[is_set])
        return self._collected() if self._found_rest() else None

    def _collected(self) -> tuple[Integers, Floats]:
        """The samples from the first one on that tells the clock; those before it, behind a break, are not counted."""
        stamps_ns, samples = (np.concatenate(parts) for parts in zip(*self._early, strict=True))
        self._early = []
        self._waiting.end()
        set_at = np.flatnonzero(stamps_ns != 0)
        self.waited = int(set_at[min(self._uncounted, set_at.size - 1)])
        self._counts[kernel.UNSET] += self.waited - int((stamps_ns[: self.waited] != 0).sum())
        return stamps_ns[self.waited :], samples[self.waited :]

    def _found_rest(self, final: bool = False) -> bool:
        while True:
            try:
                rest = self._waiting.conclude() if final else self._waiting.look()
                if rest is None:
                    return False
                self._begin(rest)
            except InputError as error:
                self._fault = f"{self.sensor}: {error}"
                if final:
                    return False
                continue
            self._fault = None
            if self.gravity is not None:
                return True
            self._uncounted = self._waiting.dropped
            # By what was counted, not by the first stamp, which may be a wild one.
            waited_s = (self._uncounted - 1) * rest.period_s
            self.first_ns = rest.epoch_ns + round(1e9 * (rest.last_time_s - waited_s))
            return True

    def _begin(self, rest: Rest) -> None:
        """Begin behind a rest, or with known gravity at the first sample that tells the clock."""
        if self.gravity is None:
            self._start(rest)
            self._rest, self._run_epoch_ns = rest, rest.epoch_ns
        else:
            known = dataclasses.replace(rest, mean_mps2=self.gravity.mean_mps2, in_motion=False)
            self.begin_known(known, rest.epoch_ns)
            self._uncounted = self._waiting.before

    def _start(self, rest: Rest) -> None:
        """Design the filters for the rate found; they start in steady state for gravity: zero, once levelled."""
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
        self._lone_room = _room(1, self._max_fill)
        self._sos = np.zeros((kernel.SECTIONS, 6))
        self.delay_s = 0.0
        if self.mode in ("causal", "zero_phase"):
            from scipy import signal  # half a second

            self._sos = signal.butter(FILTER_ORDER, settings.cutoff_hz, fs=rate_hz, output="sos")
        if self.mode == "causal":
            s[kernel.LOW_PASS : kernel.LOW_PASS_STATE] = self._sos.ravel()
            self.delay_s = group_delay_s(self._sos, rate_hz)

    def _check_rate(self, rate_hz: float) -> None:
        least = max(MIN_RATE_HZ, RATE_PER_CUTOFF * self.settings.cutoff_hz)
        lowest_hz, highest_hz = least * (1.0 - RATE_TOLERANCE), MAX_RATE_HZ * (1.0 + RATE_TOLERANCE)
        if self.mode != "survey" and not lowest_hz <= rate_hz <= highest_hz:
            raise InputError(f"a rate of {rate_hz:.4g} Hz does not fit, {least:g} to {MAX_RATE_HZ:g} Hz are needed")

    def _warnings(self, clipping: Clipping) -> list[str]:
        railing = clipping.warning(self.settings.saturation_mps2)
        lines = [railing] if railing else []
        if self._rest is not None:
            if self._rest.in_motion:
                lines.append("no rest found: gravity was averaged over motion")
            if self.gravity is not None and (line := self.gravity.warning(self._given_vertical is not None)):
                lines.append(line)
            if abs(self._gravity_mps2 / STANDARD_GRAVITY_MPS2 - 1.0) > GRAVITY_TOLERANCE:
                lines.append(f"gravity at rest reads {self._gravity_mps2:.2f} m/s^2: gain, unit or mounting is off")
            period_s, nominal_s = self._state[kernel.PERIOD], self._state[kernel.NOMINAL]
            if abs(period_s / nominal_s - 1.0) > RATE_TOLERATED:
                lines.append("the rate is 2 % off that at rest: samples get lost unnoticed, or the driver changed it")
            if self._state[kernel.JITTER] > JITTER_TOLERATED * self._rest.period_s and not self._rest.coarse:
                jitter_ms = 1e3 * float(self._state[kernel.JITTER])
                lines.append(f"stamps jitter by {jitter_ms:.2g} ms, too much to tell lost samples: some may hide")
        return lines

    # --- runs --------------------------------------------------------------------------------------------------------

    def _condition(self, stamps_ns: Integers, samples: Floats, final: bool) -> list[Block]:
        if self.mode == "rest":
            return []
        if self._undecided is not None:
            stamps_ns = np.concatenate([self._undecided[0], stamps_ns])
            samples = np.concatenate([self._undecided[1], samples])
            self._undecided = None
        blocks: list[Block] = []
        done, n = 0, stamps_ns.shape[0]
        while done < n:
            used, block, why = self._advance(stamps_ns[done:], samples[done:], final)
            done += used
            if block is not None:
                blocks += self._answer(block)
            if why == kernel.UNDECIDED:
                self._undecided = stamps_ns[done:], samples[done:]
                break
            if why == kernel.NEW_RUN:
                blocks += self._end_run(int(stamps_ns[done]))
        return blocks

    def _advance(self, stamps_ns: Integers, samples: Floats, final: bool) -> tuple[int, Block | None, int]:
        """One call of the kernel: (samples consumed, what it wrote, why it stopped)."""
        assert self._rest is not None
        epoch_ns, is_lone = self._run_epoch_ns, stamps_ns.shape[0] == 1
        room = self._lone_room if is_lone else _room(stamps_ns.shape[0], self._max_fill)
        if self.mode == "survey":
            used, written, why = self._survey(stamps_ns, samples, final, room)
        else:
            used, written, why = kernel.condition(
                stamps_ns, samples, epoch_ns, round(self.delay_s * 1e9), final, self._state, self._counts, *room
            )  # fmt: skip
        if not written:
            return used, None, why
        stamps, times, levelled, low_passed, raw, source = room
        if self._state.item(kernel.LARGEST) >= rails.LEAST_MPS2:
            self._find_rails(raw[:written], source)
        begins_ns, ends_ns = epoch_ns + round(times.item(0) * 1e9), epoch_ns + round(times.item(written - 1) * 1e9)
        begins_run, gap_s = self.runs.answered(begins_ns, ends_ns, 1.0 / self.rate_hz)
        shift_s = (epoch_ns - self._rest.epoch_ns) * 1e-9 + self.runs.lap_s - self.delay_s
        rows = stamps[:written], times[:written] + shift_s, levelled[:written], low_passed[:written, 0]
        block = Block(
            *(_copied(rows) if is_lone else rows), begins_run, gap_s, self._rest.epoch_ns, self.rate_hz,
            self.settings.cutoff_hz,
        )  # fmt: skip
        return used, block, why

    def _survey(self, stamps_ns: Integers, samples: Floats, final: bool, room: _Rows) -> tuple[int, int, int]:
        """The kernel up to its clock, so that nothing behind it is compiled; of `room` only times, raw and source."""
        _, times, _, _, raw, source = room
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
        """Nothing integrates across a break: filters start anew, and time that jumped back goes on."""
        blocks = self._filtered_run()
        self._state[kernel.LOW_PASS_STATE : kernel.MAX_GAP] = 0.0
        # Seconds count anew from each run's first stamp: those since another epoch would be too coarse to tell a rate.
        self._run_epoch_ns = next_ns
        self.runs.end(next_ns, 1.0 / self.rate_hz)
        return blocks

    def _answer(self, block: Block) -> list[Block]:
        if self.mode == "causal":
            return [block]
        if self.mode == "zero_phase":
            self._held.append(block)
        return []

    def _filtered_run(self) -> list[Block]:
        """The run that is held, filtered forward and backward."""
        if not self._held:
            return []
        stamps, times, levelled = (np.concatenate([block[k] for block in self._held]) for k in range(3))
        run = self._held[0]._replace(
            stamps_ns=stamps, time_s=times, levelled_mps2=levelled, low_passed_mps2=self.zero_phase(levelled[:, 2])
        )
        self._held = []
        return [run]


def _room(samples: int, max_fill: int) -> _Rows:
    """Where the kernel writes; what lies in it is handed out without a copy."""
    size = samples + max_fill + 2
    stamps, source = np.empty(size, dtype=np.int64), np.empty(size, dtype=np.int64)
    return stamps, np.empty(size), np.empty((size, 3)), np.empty((size, 1)), np.empty((size, 3)), source


def _copied(rows: _Answered) -> _Answered:
    """Live a block is one row of sixty: copied out, it holds no more than that, and its room serves again."""
    stamps, times, levelled, low_passed = rows
    return stamps.copy(), times.copy(), levelled.copy(), low_passed.copy()


def group_delay_s(sos: Floats, rate_hz: float) -> float:
    """Group delay at 0 Hz of second-order sections, seconds."""
    delay = 0.0
    for b0, b1, b2, a0, a1, a2 in sos.tolist():
        delay += (b1 + 2.0 * b2) / (b0 + b1 + b2) - (a1 + 2.0 * a2) / (a0 + a1 + a2)
    return delay / rate_hz
