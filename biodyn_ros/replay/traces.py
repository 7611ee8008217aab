"""Traces: data of the drawings of a replay's report, collected during the replay in constant memory."""

from __future__ import annotations

from typing import Final

import numpy as np

from biodyn_core.base.arrays import Floats, Integers
from biodyn_core.base.segments import HEAD, N_SEGMENTS, N_SENSORS, SEAT, SENSORS
from biodyn_core.pipeline.frames import Frames
from biodyn_ros.replay.spectra import ReplaySpectra
from biodyn_ros.reports.downsampling import BIN_NS, binned
from biodyn_ros.reports.motion import EVENT_HALF_NS, Envelope, StrongestEvent

ENVELOPE_BINS: Final = 800
"""Most bins that a page can show; a longer record doubles their width."""

BATCH_SAMPLES: Final = 4096
"""Frames are processed in batches of so many instants, because single blocks are too short. No figure depends on it."""

RECENT_SAMPLES: Final = 1 << 18
"""Predictions that are held for their measurement: 64 s at the highest rate, more than comparisons usually wait."""

EVENT_SENSORS: Final = (SENSORS.index(SEAT), SENSORS.index(HEAD))


class Traces:
    """Collect the traces of a replay in constant memory: `add` every push's frames; spectra: over frequency.

    The envelope has bins of 0.1 s, aligned to whole tenths of a second of stamp time; beyond ENVELOPE_BINS of them
    neighbours are merged and the width doubles. The event reaches EVENT_HALF_NS to either side of the strongest
    instant. Block cuts change nothing.
    """

    def __init__(self) -> None:
        self._predicted = _Stream(N_SEGMENTS)
        self._measured = _Stream(N_SENSORS)
        self.spectra = ReplaySpectra()
        self._event: StrongestEvent | None = None
        self._event_open = False

    def add(self, frames: Frames) -> None:
        """Add one push's frames; they must not be written to afterwards."""
        self._predicted.add(frames.predicted.stamps_ns, frames.predicted.accel_mps2)
        self._measured.add(frames.measured.stamps_ns, frames.measured.accel_mps2)
        self.spectra.add(frames.measured)
        if self._predicted.waiting + self._measured.waiting >= BATCH_SAMPLES:
            self._process()

    def predicted(self) -> Envelope:
        """The envelope of the six segments' predictions."""
        self._process()
        return self._predicted.envelope

    def measured(self) -> Envelope:
        """The envelope of the six sensors' measurements."""
        self._process()
        return self._measured.envelope

    @property
    def first_ns(self) -> int:
        """The earliest stamp; 0 without frames."""
        self._process()
        return min((s.first_ns for s in (self._predicted, self._measured) if s.first_ns is not None), default=0)

    def event(self) -> StrongestEvent | None:
        """The frames around the strongest instant; None without a value of seat and head."""
        self._process()
        return self._event

    def _process(self) -> None:
        # A prediction comes before the measurement of its instant, so it is there when the event closes.
        self._predicted.process()
        stamps_ns, accel_mps2 = self._measured.process()
        if stamps_ns.size == 0:
            return
        self._update_event(stamps_ns, accel_mps2)
        last_ns = int(stamps_ns[-1])
        if self._event is not None and self._event_open:
            self._event = self._around(self._event)
            self._event_open = abs(last_ns - self._event.peak_ns) < EVENT_HALF_NS
        for stream in (self._predicted, self._measured):
            stream.drop_before(last_ns - 2 * EVENT_HALF_NS)

    def _update_event(self, stamps_ns: Integers, accel_mps2: Floats) -> None:
        accel = np.abs(accel_mps2[:, EVENT_SENSORS])
        accel[np.isnan(accel)] = -1.0
        row, column = divmod(int(accel.argmax()), len(EVENT_SENSORS))
        peak = float(accel[row, column])
        if peak > (-1.0 if self._event is None else self._event.peak_mps2):
            nothing = np.empty(0, dtype=np.int64), np.empty((0, N_SEGMENTS))
            self._event = StrongestEvent(SENSORS[EVENT_SENSORS[column]], int(stamps_ns[row]), peak, *nothing, *nothing)
            self._event_open = True

    def _around(self, event: StrongestEvent) -> StrongestEvent:
        begin, end = event.peak_ns - EVENT_HALF_NS, event.peak_ns + EVENT_HALF_NS
        predicted, measured = self._predicted.between(begin, end), self._measured.between(begin, end)
        return StrongestEvent(event.sensor, event.peak_ns, event.peak_mps2, *predicted, *measured)


class _Stream:
    """One stream of six channels: waiting rows, recent rows, and the envelope of all rows."""

    def __init__(self, channels: int) -> None:
        self._stamps_ns: list[Integers] = []
        self._accel_mps2: list[Floats] = []
        self._recent: tuple[Integers, Floats] = np.empty(0, dtype=np.int64), np.empty((0, channels))
        self.waiting = 0
        self.first_ns: int | None = None
        none = np.empty((0, channels))
        self.envelope = Envelope(BIN_NS, np.empty(0, dtype=np.int64), none, none)

    def add(self, stamps_ns: Integers, accel_mps2: Floats) -> None:
        if stamps_ns.size:
            self._stamps_ns.append(stamps_ns)
            self._accel_mps2.append(accel_mps2)
            self.waiting += stamps_ns.size

    def process(self) -> tuple[Integers, Floats]:
        """Add the waiting rows to envelope and recent rows, and return them."""
        if not self.waiting:
            return self._recent[0][:0], self._recent[1][:0]
        stamps_ns, accel_mps2 = np.concatenate(self._stamps_ns), np.concatenate(self._accel_mps2)
        self._stamps_ns, self._accel_mps2, self.waiting = [], [], 0
        first_ns = int(stamps_ns.min())
        self.first_ns = first_ns if self.first_ns is None else min(self.first_ns, first_ns)
        self.envelope = _widened(self.envelope, stamps_ns, accel_mps2)
        old_ns, old = self._recent
        recent_ns, recent = np.concatenate([old_ns, stamps_ns]), np.concatenate([old, accel_mps2])
        self._recent = recent_ns[-RECENT_SAMPLES:], recent[-RECENT_SAMPLES:]
        return stamps_ns, accel_mps2

    def between(self, begin_ns: int, end_ns: int) -> tuple[Integers, Floats]:
        stamps_ns, accel_mps2 = self._recent
        here = (stamps_ns >= begin_ns) & (stamps_ns <= end_ns)
        return stamps_ns[here], accel_mps2[here]

    def drop_before(self, begin_ns: int) -> None:
        stamps_ns, accel_mps2 = self._recent
        keep = stamps_ns >= begin_ns
        if not keep.all():
            self._recent = stamps_ns[keep], accel_mps2[keep]


def _widened(envelope: Envelope, stamps_ns: Integers, accel_mps2: Floats) -> Envelope:
    """The envelope with further samples, its bins doubled until there are few enough."""
    width, *earlier = envelope
    added = binned(stamps_ns, accel_mps2, accel_mps2, width)
    begins, low, high = binned(*(np.concatenate(pair) for pair in zip(earlier, added, strict=True)), width)
    while begins.size > ENVELOPE_BINS:
        width *= 2
        begins, low, high = binned(begins, low, high, width)
    return Envelope(width, begins, low, high)
