"""Serialized trajectory_msgs/msg/JointTrajectory: blocks of samples as one message; numpy only, no ROS.

In CDR the message is a std_msgs/Header, the sequence of names, and the sequence of points. A point is four sequences of
float64 (positions, velocities, accelerations, effort) and a Duration, time_from_start. Sequences of float64 are aligned
to 8 bytes, so the size of a point depends on where it begins. From the first number of the first point on, all points
repeat with one stride.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Floats, Integers
from biodyn_core.base.errors import InputError
from biodyn_ros.bag.cdr import LITTLE, NS_PER_S, frame_bytes, stamp_refusal

JOINT_TRAJECTORY_TYPE: Final = "trajectory_msgs/msg/JointTrajectory"
SEQUENCES: Final = ("positions", "velocities", "accelerations", "effort")

_BEGIN: Final = 4
"""Alignment counts from the end of the encapsulation."""


class TrajectoryTemplate:
    """JointTrajectory messages of a fixed frame, fixed names and fixed sequences; the other sequences stay empty."""

    def __init__(self, frame_id: str, names: Sequence[str], sequences: Sequence[str]) -> None:
        self.names, self.sequences = tuple(names), tuple(name for name in SEQUENCES if name in sequences)
        head = struct.pack("<I", len(frame_bytes(frame_id))) + frame_bytes(frame_id)
        head = _with_strings(_padded(head, 4), self.names)
        self._head = head
        begin = len(LITTLE) + 8 + len(head) + 4
        lengths, first, end = _point(begin, len(self.names), self.sequences)
        anchor = first[self.sequences[0]]
        self._lengths = lengths[: anchor - begin]
        following, second, _ = _point(end, len(self.names), self.sequences)
        stride = second[self.sequences[0]] - anchor
        # One row is the rest of a point, and what the next one has before its first number.
        self._tail = stride - (end - anchor)
        row = lengths[anchor - begin :] + following[: self._tail]
        self._row = np.frombuffer(row, np.uint8)
        self._rows = self._row[None].copy()
        self._fields = np.dtype(
            {
                "names": [*self.sequences, "sec", "nanosec"],
                "formats": [*[("<f8", (len(self.names),))] * len(self.sequences), "<i4", "<u4"],
                "offsets": [*(at - anchor for at in first.values()), end - anchor - 8, end - anchor - 4],
                "itemsize": stride,
            }
        )

    def fill(self, stamps_ns: Integers, values: Mapping[str, Floats]) -> bytes:
        """The serialized message of n >= 1 samples: stamps (n,), and each sequence (n, names).

        The header has the first stamp. Raises InputError for a stamp outside int32 seconds.
        """
        if stamps_ns.size > len(self._rows):  # kept for the next message, because tiling costs more than the rest
            self._rows = np.tile(self._row, (stamps_ns.size, 1))
        rows = self._rows[: stamps_ns.size]
        fields = rows.view(self._fields)[:, 0]
        for name in self.sequences:
            fields[name] = values[name]
        begin_ns = int(stamps_ns[0])
        fields["sec"], fields["nanosec"] = np.divmod(stamps_ns - begin_ns, NS_PER_S)
        try:
            stamp = struct.pack("<iI", *divmod(begin_ns, NS_PER_S))
        except struct.error:
            raise InputError(stamp_refusal(begin_ns)) from None
        body = rows.tobytes()
        count = struct.pack("<I", stamps_ns.size)
        return b"".join((LITTLE, stamp, self._head, count, self._lengths, body[: len(body) - self._tail]))

    def times_ns(self, message: bytes) -> Integers:
        """The stamps (n,) of a message of this template."""
        begin = len(LITTLE) + 8 + len(self._head) + 4
        sec, nanosec = struct.unpack_from("<iI", message, 4)
        (count,) = struct.unpack_from("<I", message, begin - 4)
        body = message[begin + len(self._lengths) :] + bytes(self._tail)
        fields = np.frombuffer(body, self._fields, count)
        return sec * NS_PER_S + nanosec + fields["sec"].astype(np.int64) * NS_PER_S + fields["nanosec"]


def _padded(part: bytes, to: int) -> bytes:
    """A part of the body, behind a multiple of `to` bytes, with padding up to the next multiple."""
    return part + bytes(-len(part) % to)


def _with_strings(head: bytes, strings: Sequence[str]) -> bytes:
    """A head, whose length is a multiple of 4, followed by a sequence of strings and padding."""
    head += struct.pack("<I", len(strings))
    for text in strings:
        encoded = text.encode("utf-8") + b"\0"
        head += _padded(struct.pack("<I", len(encoded)) + encoded, 4)
    return head


def _point(begin: int, width: int, sequences: Sequence[str]) -> tuple[bytes, dict[str, int], int]:
    """The bytes of a point that begins at a byte of the message, zero but for the lengths of its sequences.

    Also the byte of the message where the numbers of each sequence begin, and the end of the point.
    """
    part, numbers_at = b"", {}
    for name in SEQUENCES:
        given = name in sequences
        part += struct.pack("<I", width if given else 0)
        if given:
            part += bytes(-(begin - _BEGIN + len(part)) % 8)
            numbers_at[name] = begin + len(part)
            part += bytes(8 * width)
    part += bytes(8)
    return part, numbers_at, begin + len(part)
