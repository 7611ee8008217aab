"""Writes events as bags by the public mcap package: six topics of sensor_msgs/Imu and nothing else."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np
from mcap.writer import CompressionType, Writer
from numpy.typing import NDArray

from world.effects.wearing import Floats, Stream

IMU: Final = np.dtype(
    {
        "names": ["order", "sec", "nanosec", "frame_bytes", "frame", "not_estimated", "w", "gyro", "accel"],
        "formats": ["V4", "<i4", "<u4", "<u4", "S4", "<f8", "<f8", ("<f8", 3), ("<f8", 3)],
        # Behind four bytes of encapsulation: header, orientation (x, y, z, w), covariance (9), rate (3), ...
        "offsets": [0, 4, 8, 12, 16, 52, 44, 124, 220],
        "itemsize": 316,
    }
)
"""sensor_msgs/msg/Imu in little-endian CDR with a frame_id of three letters; doubles start on multiples of 8 from 4."""

DEFINITION: Final = """\
std_msgs/Header header
geometry_msgs/Quaternion orientation
float64[9] orientation_covariance
geometry_msgs/Vector3 angular_velocity
float64[9] angular_velocity_covariance
geometry_msgs/Vector3 linear_acceleration
float64[9] linear_acceleration_covariance
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
================================================================================
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
================================================================================
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
"""


PIECE: Final = 1 << 16
"""Messages that are encoded at once: a session has millions of them."""


def encoded(stamps_ns: NDArray[np.int64], force: Floats, rates: Floats) -> bytes:
    """Messages of the dtype `IMU`, one behind the other: force (n, 3) and rates (n, 3) under these stamps (n,)."""
    out = np.zeros(len(stamps_ns), IMU)
    out["order"] = np.void(b"\x00\x01\x00\x00")
    out["sec"], out["nanosec"] = np.divmod(stamps_ns, 1_000_000_000)
    out["frame_bytes"], out["frame"] = 4, b"imu"
    out["w"], out["not_estimated"] = 1.0, -1.0
    out["accel"], out["gyro"] = force, rates
    return out.tobytes()


def write(path: Path, streams: Mapping[str, Stream], begin_ns: int) -> None:
    """One event as one MCAP file; messages in the order of their stamps, logged as they are stamped."""
    path.parent.mkdir(parents=True, exist_ok=True)
    stamps_ns, force, rates = (np.concatenate(column) for column in zip(*streams.values(), strict=True))
    stamps_ns = begin_ns + stamps_ns
    channel = np.repeat(np.arange(len(streams)), [len(one[0]) for one in streams.values()])
    order, size = np.argsort(stamps_ns, kind="stable"), IMU.itemsize
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=4 << 20, compression=CompressionType.LZ4)
        writer.start(profile="ros2", library="")
        schema = writer.register_schema("sensor_msgs/msg/Imu", "ros2msg", DEFINITION.encode())
        ids = [writer.register_channel(f"imu/{name}/data", "cdr", schema) for name in streams]
        for begin in range(0, len(order), PIECE):
            here = order[begin : begin + PIECE]
            data = encoded(stamps_ns[here], force[here], rates[here])
            for i, (which, ns) in enumerate(zip(channel[here].tolist(), stamps_ns[here].tolist(), strict=True)):
                writer.add_message(ids[which], ns, data[i * size : (i + 1) * size], ns)
        writer.finish()
