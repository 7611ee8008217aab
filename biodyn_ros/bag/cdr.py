"""Converts serialized sensor_msgs/msg/Imu and geometry_msgs/msg/AccelStamped to arrays and back; numpy only, no ROS.

Both messages start with std_msgs/Header, followed by float64 only. In CDR the bytes are:

    0   encapsulation: 00, then 01 for little or 00 for big endian, then two option bytes
    4   stamp.sec int32      8  stamp.nanosec uint32      12  length of frame_id uint32, its NUL included
    16  frame_id, then padding to a multiple of 8 counted from byte 4; there the body starts

    Imu body          orientation +0 (4), its covariance +32 (9), angular velocity +104 (3), covariance +128 (9),
                      linear acceleration +200 (3), covariance +224 (9); 296 bytes
    AccelStamped body linear +0 (3), angular +24 (3); 48 bytes

No message object is needed: given the offset of each message, two gathers read a block of messages, and a third one
the angular velocity if requested. Writers do not zero their padding: compare values, never serialized bytes.
"""

from __future__ import annotations

import contextlib
import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from biodyn_core.base.arrays import Flags, Floats, Integers
from biodyn_core.base.errors import InputError
from biodyn_core.base.wording import counted

Bytes = NDArray[np.uint8]

IMU_TYPE: Final = "sensor_msgs/msg/Imu"
ACCEL_STAMPED_TYPE: Final = "geometry_msgs/msg/AccelStamped"
STRING_TYPE: Final = "std_msgs/msg/String"

NS_PER_S: Final = 1_000_000_000

FEW: Final = 24
"""Up to so many messages are decoded faster one by one."""


@dataclass(frozen=True)
class _Layout:
    """A stamped message of float64: type, bytes of its body, and (byte offset, count) of the numbers to read."""

    type: str
    body_bytes: int
    numbers_at: tuple[tuple[int, int], ...] = ()


_HEADER_BYTES = 16
_STRING_AT = 8
_GYRO_AT = 104
_ACCEL_AT = 200
# Acceleration and angular velocity, each followed by the first element of its covariance.
_IMU = _Layout(IMU_TYPE, 296, ((_ACCEL_AT, 4),))
_IMU_WITH_GYRO = _Layout(IMU_TYPE, 296, ((_ACCEL_AT, 4), (_GYRO_AT, 4)))
_ACCEL_STAMPED = _Layout(ACCEL_STAMPED_TYPE, 48)
_STAMPED = _Layout("message that starts with std_msgs/Header", 0)

LITTLE = b"\x00\x01\x00\x00"
_HEAD = {0: struct.Struct(">iII"), 1: struct.Struct("<iII")}
_STAMP = {0: struct.Struct(">iI"), 1: struct.Struct("<iI")}
# Of the covariance after the acceleration only the first element is read, but a message cut inside it is refused.
_ACCEL = {0: struct.Struct(">4d64x"), 1: struct.Struct("<4d64x")}


@dataclass(frozen=True, eq=False)
class ImuBlock:
    """Samples of one sensor: header stamps int64 (n,), specific force (n, 3) and angular rate (n, 3), SI units.

    gyro_radps is None if it was not requested. Both are NaN in messages without one: covariance[0] = -1 (Imu.msg).
    """

    stamps_ns: Integers
    accel_mps2: Floats
    gyro_radps: Floats | None

    def __len__(self) -> int:
        return len(self.stamps_ns)


def decode_imu(messages: Sequence[bytes], gyro: bool = False) -> ImuBlock:
    """Decode serialized Imu messages, order kept; frame_id lengths and byte orders may differ among them.

    With `gyro` the angular velocity too. InputError names the first message that is cut or is no Imu.
    """
    if not gyro and len(messages) <= FEW:
        with contextlib.suppress(InputError):  # below, the refusal names the message
            stamps_ns, accel_mps2 = zip(*map(decode_imu_one, messages), strict=True) if messages else ((), ())
            return ImuBlock(np.array(stamps_ns, dtype=np.int64), np.array(accel_mps2).reshape(-1, 3), None)
    return decode_imu_in(*_joined(messages), gyro)


def decode_imu_in(buffer: Bytes, offsets: Integers, lengths: Integers, gyro: bool = False) -> ImuBlock:
    """Decode the Imu messages in a buffer, such as a decompressed chunk, at offsets[i] with lengths[i] bytes.

    Reads stamp and linear acceleration, and with `gyro` the angular velocity. Nothing outside a message is read:
    InputError names the first message that exceeds the buffer, is cut, or is no Imu.
    """
    if not gyro:
        stamps_ns, (accel,) = _decode(_IMU, buffer, offsets, lengths)
        return ImuBlock(stamps_ns, _given(accel), None)
    stamps_ns, (accel, rates) = _decode(_IMU_WITH_GYRO, buffer, offsets, lengths)
    return ImuBlock(stamps_ns, _given(accel), _given(rates))


def _given(read: Floats) -> Floats:
    """The vectors (n, 3) of rows (n, 4), NaN where the covariance that follows says that there is none."""
    read[read[:, 3] == -1.0] = np.nan
    return np.ascontiguousarray(read[:, :3])


def decode_imu_one(message: bytes) -> tuple[int, tuple[float, float, float]]:
    """Header stamp in ns and linear acceleration in m/s^2 of one Imu, for the live callback; takes less than 1 us.

    InputError for a message that is cut or is no Imu.
    """
    try:
        order = message[0] << 8 | message[1]
        sec, nanosec, frame_bytes = _HEAD[order].unpack_from(message, 4)
        x, y, z, covariance = _ACCEL[order].unpack_from(message, 4 + _ACCEL_AT + ((frame_bytes + 19) & ~7))
    except (struct.error, IndexError, KeyError):
        raise InputError(_refusal(_IMU, message)) from None
    return sec * NS_PER_S + nanosec, (x, y, z) if covariance != -1.0 else (math.nan, math.nan, math.nan)


def decode_string(message: bytes) -> str:
    """The text of a std_msgs/String; InputError for one that is cut."""
    if len(message) >= _STRING_AT and message[0] == 0 and message[1] <= 1:
        end = _STRING_AT + int.from_bytes(message[4:_STRING_AT], "little" if message[1] else "big")
        if _STRING_AT < end <= len(message):
            return bytes(message[_STRING_AT : end - 1]).decode("utf-8", errors="replace")
    raise InputError(f"{STRING_TYPE}: the message is cut or not CDR")


def restamp(message: bytes, stamp_ns: int) -> bytes:
    """The same message with another header stamp; for any type whose first field is std_msgs/Header.

    InputError for a message that is cut and for a stamp outside int32 seconds.
    """
    _check_header(message)
    return b"".join((message[:4], _pack_stamp(stamp_ns, message[1]), message[12:]))


def shift_stamp(message: bytes, by_ns: int) -> bytes:
    """The same message with its header stamp shifted by some ns; otherwise as `restamp`. A zero stamp stays zero."""
    stamp_ns = stamp_of(message)
    return restamp(message, stamp_ns + by_ns) if stamp_ns else message


def stamp_of(message: bytes) -> int:
    """The header stamp in ns of any message whose first field is std_msgs/Header; InputError when it is cut."""
    _check_header(message)
    sec, nanosec = _STAMP[message[1]].unpack_from(message, 4)
    return int(sec * NS_PER_S + nanosec)


def encode_imu(
    stamps_ns: Integers,
    accel_mps2: Floats,
    gyro_radps: Floats | None,
    frame_id: str,
    accel_variance: Floats | None = None,
) -> Bytes:
    """Serialize n Imu messages, little endian, uint8 (n, size), padding zeroed.

    stamps_ns (n,), accel_mps2 and gyro_radps (n, 3); accel_variance (n, 3), (m/s^2)^2, is the diagonal of the
    acceleration's covariance. The orientation is the identity with orientation_covariance[0] = -1, which Imu.msg reads
    as "not estimated", as is the angular velocity's without one; the other covariances are 0, "unknown".
    InputError for arrays that do not fit together, a NUL in frame_id, or stamps outside int32 seconds.
    """
    out, body = _blank(_IMU, stamps_ns, frame_id)
    _put(out, body + 24, np.float64(1.0))
    _put(out, body + 32, np.float64(-1.0))
    if gyro_radps is None:
        _put(out, body + _GYRO_AT + 24, np.float64(-1.0))
    else:
        _put(out, body + _GYRO_AT, _vectors(gyro_radps, len(out), "gyro_radps"))
    _put(out, body + _ACCEL_AT, _vectors(accel_mps2, len(out), "accel_mps2"))
    if accel_variance is not None:
        diagonal = _vectors(accel_variance, len(out), "accel_variance")
        for axis in range(3):
            _put(out, body + _ACCEL_AT + 24 + 32 * axis, diagonal[:, axis])
    return out


def encode_accel_stamped(stamps_ns: Integers, vertical_mps2: Floats, frame_id: str) -> Bytes:
    """Serialize n AccelStamped messages, uint8 (n, size): stamps (n,) and the vertical (n,) in linear.z, the rest 0.

    InputError as `encode_imu`.
    """
    out, body = _blank(_ACCEL_STAMPED, stamps_ns, frame_id)
    vertical = np.asarray(vertical_mps2, dtype=np.float64)
    if vertical.shape != (len(out),):
        raise InputError(f"vertical_mps2 has shape {vertical.shape}, one value per stamp is ({len(out)},)")
    _put(out, body + 16, vertical)
    return out


class AccelStampedTemplate:
    """One AccelStamped of a fixed frame, filled for each sample: vertical in linear.z, everything else 0.

    One struct call builds the whole message, which is twice as fast as changing a bytearray and copying it.
    """

    def __init__(self, frame_id: str) -> None:
        frame = frame_bytes(frame_id)
        middle = struct.pack("<I", len(frame)) + frame
        middle += bytes(-(8 + len(middle)) % 8 + 16)  # padding, linear.x, linear.y
        self._middle = middle
        self._pack = struct.Struct(f"<4siI{len(middle)}sd24x").pack

    def fill(self, stamp_ns: int, vertical_mps2: float) -> bytes:
        """The serialized message, little endian; InputError for a stamp outside int32 seconds."""
        sec, nanosec = divmod(stamp_ns, NS_PER_S)
        try:
            return self._pack(LITTLE, sec, nanosec, self._middle, vertical_mps2)
        except struct.error:
            raise InputError(stamp_refusal(stamp_ns)) from None


def gather(buffer: Bytes, offsets: Integers, item_bytes: int) -> NDArray[np.void]:
    """Copies of the item_bytes bytes at each offset, void (n,), n >= 1: one memcpy each, at any alignment.

    The caller has checked that 0 <= offsets and offsets + item_bytes <= buffer.size.
    """
    return _windows(buffer, item_bytes)[offsets]


def scatter(buffer: Bytes, offsets: Integers, items: NDArray[np.void]) -> None:
    """Copy item i, void (n,), n >= 1, to buffer[offsets[i]:]; the caller has checked the bounds."""
    _windows(buffer, items.dtype.itemsize)[offsets] = items


def _windows(buffer: Bytes, item_bytes: int) -> NDArray[np.void]:
    """All windows of item_bytes bytes in the buffer, as one overlapping view."""
    return np.ndarray((buffer.size - item_bytes + 1,), f"V{item_bytes}", buffer=buffer, strides=(1,))


def _joined(messages: Sequence[bytes]) -> tuple[Bytes, Integers, Integers]:
    lengths = np.fromiter(map(len, messages), dtype=np.int64, count=len(messages))
    return np.frombuffer(b"".join(messages), dtype=np.uint8), np.cumsum(lengths) - lengths, lengths


def _decode(layout: _Layout, buffer: Bytes, offsets: Integers, lengths: Integers) -> tuple[Integers, list[Floats]]:
    """Stamps and the layout's numbers, for messages of either byte order."""
    if len(offsets) == 0:
        return np.empty(0, dtype=np.int64), [np.empty((0, count)) for _, count in layout.numbers_at]
    outside = (lengths < _HEADER_BYTES) | (offsets < 0) | (offsets > buffer.size - lengths)
    if outside.any():
        raise InputError(_refusal_of_first(layout, buffer, offsets, lengths, outside))
    head = gather(buffer, offsets, _HEADER_BYTES).view(np.uint8).reshape(-1, _HEADER_BYTES)
    encapsulation = head.view("<u2")[:, 0]
    little = encapsulation == 0x0100
    if little.all():
        return _decode_ordered(layout, "<", head, buffer, offsets, lengths)
    unknown = ~little & (encapsulation != 0)
    if unknown.any():
        raise InputError(_refusal_of_first(layout, buffer, offsets, lengths, unknown))

    stamps_ns = np.empty(len(offsets), dtype=np.int64)
    numbers = [np.empty((len(offsets), count)) for _, count in layout.numbers_at]
    for rows, order in ((np.flatnonzero(little), "<"), (np.flatnonzero(~little), ">")):
        stamps_ns[rows], found = _decode_ordered(layout, order, head[rows], buffer, offsets[rows], lengths[rows])
        for all_rows, part in zip(numbers, found, strict=True):
            all_rows[rows] = part
    return stamps_ns, numbers


def _decode_ordered(
    layout: _Layout, order: str, head: Bytes, buffer: Bytes, offsets: Integers, lengths: Integers
) -> tuple[Integers, list[Floats]]:
    """The same for one byte order, "<" or ">"; head is uint8 (n, 16) and the messages are known to lie inside."""
    if len(offsets) == 0:
        return np.empty(0, dtype=np.int64), [np.empty((0, count)) for _, count in layout.numbers_at]
    words = head.view(f"{order}u4")
    body = 4 + ((words[:, 3].astype(np.int64) + 19) & ~7)
    cut = body > lengths - layout.body_bytes
    if cut.any():
        raise InputError(_refusal_of_first(layout, buffer, offsets, lengths, cut))
    stamps_ns = head.view(f"{order}i4")[:, 1].astype(np.int64) * NS_PER_S + words[:, 2]
    numbers = [
        gather(buffer, offsets + body + at, 8 * count).view(f"{order}f8").reshape(-1, count)
        for at, count in layout.numbers_at
    ]
    return stamps_ns, [found.astype(np.float64, copy=False) for found in numbers]


def _refusal_of_first(layout: _Layout, buffer: Bytes, offsets: Integers, lengths: Integers, bad: Flags) -> str:
    """The line for the first bad message of a block."""
    i = int(np.argmax(bad))
    offset, length = int(offsets[i]), int(lengths[i])
    where = f"message {i + 1} of {len(offsets)}"
    if offset < 0 or length < 0 or offset + length > buffer.size:
        size = counted(buffer.size, "byte")
        return f"{where}: {counted(length, 'byte')} at byte {offset} exceed a buffer of {size}"
    return f"{where}: {_refusal(layout, buffer[offset : offset + length].tobytes())}"


def _refusal(layout: _Layout, message: bytes) -> str:
    """The reason why one message cannot be read, with a remedy."""
    advice = f"it is cut or not a {layout.type}: check the topic's type and the bag"
    if len(message) < _HEADER_BYTES:
        return f"{counted(len(message), 'byte')} cannot hold a header; {advice}"
    if message[0] != 0 or message[1] > 1:
        return f"encapsulation {message[:2].hex(' ')} is not plain CDR (00 00 or 00 01); {advice}"
    frame_bytes = _HEAD[message[1]].unpack_from(message, 4)[2]
    needed = 4 + ((frame_bytes + 19) & ~7) + layout.body_bytes
    return f"{counted(len(message), 'byte')}, but {needed} are needed with a frame_id of {frame_bytes}; {advice}"


def _check_header(message: bytes) -> None:
    """Raise InputError unless the message contains a whole std_msgs/Header."""
    if len(message) >= _HEADER_BYTES and message[0] == 0 and message[1] <= 1:
        frame_bytes = _HEAD[message[1]].unpack_from(message, 4)[2]
        if _HEADER_BYTES + frame_bytes <= len(message):
            return
    raise InputError(_refusal(_STAMPED, bytes(message)))


def _pack_stamp(stamp_ns: int, order: int) -> bytes:
    try:
        return _STAMP[order].pack(*divmod(stamp_ns, NS_PER_S))
    except struct.error:
        raise InputError(stamp_refusal(stamp_ns)) from None


def stamp_refusal(stamp_ns: int) -> str:
    """The line about a stamp outside int32 seconds."""
    return f"stamp {stamp_ns} ns does not fit a ROS stamp: seconds from -2147483648 to 2147483647 are allowed"


def frame_bytes(frame_id: str) -> bytes:
    """A frame_id with its NUL; raises InputError for one that contains a NUL."""
    if "\0" in frame_id:
        raise InputError(f"frame_id {frame_id!r} contains a NUL: use printable characters")
    return frame_id.encode("utf-8") + b"\0"


def _blank(layout: _Layout, stamps_ns: Integers, frame_id: str) -> tuple[Bytes, int]:
    """All messages with encapsulation, stamp, frame_id and a zero body; and the offset of the body."""
    stamps = np.asarray(stamps_ns)
    if stamps.ndim != 1 or stamps.dtype.kind not in "iu":
        raise InputError(f"stamps_ns must be whole nanoseconds of shape (n,), not {stamps.dtype} {stamps.shape}")
    sec, nanosec = np.divmod(stamps.astype(np.int64), NS_PER_S)
    outside = (sec < -(2**31)) | (sec >= 2**31)
    if outside.any():
        raise InputError(stamp_refusal(int(stamps[np.argmax(outside)])))
    frame = frame_bytes(frame_id)
    body = 4 + ((len(frame) + 19) & ~7)
    out = np.zeros((len(stamps), body + layout.body_bytes), dtype=np.uint8)
    out[:, :4] = np.frombuffer(LITTLE, dtype=np.uint8)
    _put(out, 4, sec.astype("<i4"))
    _put(out, 8, nanosec.astype("<u4"))
    _put(out, 12, np.uint32(len(frame)))
    out[:, 16 : 16 + len(frame)] = np.frombuffer(frame, dtype=np.uint8)
    return out, body


def _put(out: Bytes, at: int, values: NDArray[np.generic] | np.generic) -> None:
    """Write one little-endian value or row of values per message at byte `at`: (n,), (n, k) or one for all."""
    array = np.asarray(values)
    array = array.astype(array.dtype.newbyteorder("<"), copy=False)
    width = array.dtype.itemsize * (array.shape[1] if array.ndim == 2 else 1)
    rows = np.ascontiguousarray(array).reshape(-1, width // array.dtype.itemsize).view(np.uint8)
    out[:, at : at + width] = rows


def _vectors(values: Floats, n: int, name: str) -> Floats:
    array = np.asarray(values, dtype=np.float64)
    if array.shape != (n, 3):
        raise InputError(f"{name} has shape {array.shape}, one 3-vector per stamp is ({n}, 3)")
    return array
