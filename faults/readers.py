"""All readers of files and messages as functions of bytes, each with a small corpus of valid input."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np

from biodyn_core.base.digests import digest
from biodyn_core.base.segments import SENSORS
from biodyn_core.body.parameters import LOWER, UPPER
from biodyn_core.body.subject import load_subject
from biodyn_core.exposure.limits import load_limits
from biodyn_core.identification.phase1 import Search
from biodyn_core.pipeline.continued_exposure import ContinuedExposure
from biodyn_core.pipeline.pipeline import Pipeline
from biodyn_ros.bag import BagWriter, imu_blocks, open_bag
from biodyn_ros.bag.cdr import IMU_TYPE, decode_imu, decode_imu_one, encode_imu, stamp_of
from biodyn_ros.base.resources import config_file, subject_file
from biodyn_ros.blue_trident import ImportOptions, document_of, import_blue_trident, text_of
from biodyn_ros.blue_trident.exports import find_exports
from biodyn_ros.fit.campaign_file import load_campaign
from biodyn_ros.node.exposure_store import StateFile, identity_of
from biodyn_ros.work.checkpoint import Checkpoint
from biodyn_ros.work.part_store import PartStore
from faults.ride import ride, subject

TOPIC: Final = "/imu/seat/data"


@dataclass(frozen=True)
class Reader:
    """read: reads a file and raises only InputError; good: the valid files."""

    suffix: str
    read: Callable[[Path], object]
    good: Callable[[Path], list[bytes]]


def _bag(path: Path) -> None:
    with open_bag(path) as bag:
        for _, block in imu_blocks(bag, [topic.name for topic in bag.topics if topic.type == IMU_TYPE]):
            assert len(block.stamps_ns) == len(block.accel_mps2)
        str(bag.warnings), bag.metadata("biodyn")


def _messages(count: int = 60) -> tuple[np.ndarray, np.ndarray]:
    one = ride()["seat"]
    stamps_ns = one.stamps_ns[:count]
    return stamps_ns, encode_imu(stamps_ns, one.accel_mps2[:count], np.zeros((count, 3)), "imu")


def _bags(directory: Path) -> list[bytes]:
    found = []
    for compression in ("none", "lz4", "zstd"):
        path = directory / f"{compression}.mcap"
        with BagWriter(path, compression=compression, chunk_bytes=4096) as writer:
            writer.add_topic(TOPIC, IMU_TYPE)
            writer.add_metadata("biodyn", {"made_by": "faults"})
            stamps_ns, messages = _messages()
            writer.write(TOPIC, stamps_ns, messages)
        found.append(path.read_bytes())
    return found


def _cdr(path: Path) -> None:
    message = path.read_bytes()
    decode_imu([message])
    decode_imu_one(message)
    stamp_of(message)


def _checkpoint(path: Path) -> None:
    Checkpoint(path, "a problem", resume=True)


def _checkpoints(directory: Path) -> list[bytes]:
    checkpoint = Checkpoint(directory / "good.json", "a problem")
    theta = np.array([0.9 * LOWER[:13] + 0.1 * UPPER[:13], 0.5 * (LOWER[:13] + UPPER[:13])])
    checkpoint.add("road", Search(theta, np.array([0.1, 0.2]), 100, Counter(infinite=3)))
    return [(directory / "good.json").read_bytes()]


def _states(directory: Path) -> list[bytes]:
    pipeline = Pipeline(subject())
    for name in SENSORS:
        one = ride()[name]
        pipeline.push(name, one.stamps_ns[:2000], one.accel_mps2[:2000])
    file = StateFile(directory / "good.json")
    file.close(ContinuedExposure(pipeline).checkpoint(identity_of(subject(), {})))
    return [file.path.read_bytes()]


def _state(path: Path) -> None:
    """Read the state as the node does, with a corrected digest, as an attacker could."""
    try:
        document = json.loads(path.read_bytes())
        if isinstance(document, dict):
            path.write_text(json.dumps(document | {"digest": digest(document.get("kept"))}))
    except (ValueError, RecursionError):
        pass
    checkpoint = StateFile(path).read()
    assert checkpoint is not None
    ContinuedExposure(Pipeline(subject())).resume(checkpoint)


def _import(path: Path) -> None:
    """Import a file with all its sensors, as `biodyn import-blue-trident`."""
    serials = find_exports(path).serials()
    mapping = dict(zip(SENSORS, serials, strict=False))
    with TemporaryDirectory() as directory:
        outcome = import_blue_trident(path, Path(directory) / "bag.mcap", ImportOptions(mapping))
    text_of(outcome), json.dumps(document_of(outcome), allow_nan=False)


def _capture_u(path: Path) -> None:
    _import(path.rename(path.with_name("anna_TS-02374_2021-05-12_lowg.csv")))


def _exports_of_capture_u(_: Path) -> list[bytes]:
    one = ride()["seat"]
    names = b"unix_timestamp_microsec,time_s,ax_m/s/s,ay_m/s/s,az_m/s/s,gx_deg/s,gy_deg/s,gz_deg/s\n"
    rows = [
        f"{stamp // 1000},{1e-9 * (stamp - one.stamps_ns[0]):.6f},{x:.5f},{y:.5f},{z:.5f},1.5,-2.5,0.25\n".encode()
        for stamp, (x, y, z) in zip(one.stamps_ns[:60].tolist(), one.accel_mps2[:60].tolist(), strict=True)
    ]
    return [names + b"".join(rows)]


def _exports_of_nexus(_: Path) -> list[bytes]:
    """Two sensors, one of which starts late and saturates once, as written by Nexus and by Excel."""
    channels = ("accel", "gyro", "mag", "Global Angle", "HighG")
    names = ",," + ",".join(f"{serial} - {channel},," for serial in ("TS-01874", "TS-01902") for channel in channels)
    axes = "Frame,Sub Frame" + ",x,y,z" * 10
    units = ",," + ",".join([",".join([unit] * 3) for unit in ("mm/s²", "deg/s", "T", "deg", "mm/s²")] * 2)
    rows = []
    for k in range(160):
        z = 170_000.0 if 120 < k < 125 else 9806.65 + 3.0 * np.sin(k)
        rest = f"1.5,-2.5,.25,2e-05,1e-05,-3e-05,10,20,30,0,1500,{z + 9000:.6g}"
        one = f"{20.5 * np.sin(k):.4g},-12.25,{min(z, 156_900.0):.6g},{rest}"
        rows.append(f"{1 + k // 5},{k % 5},{one},{one if k > 20 else ','.join(['0'] * 15)}")
    text = "\r\n".join(["\ufeff", "", "Devices", "250", names, axes, units, *rows, ""])
    return [text.encode(), text.replace("\r\n\r\n", "", 1).replace("Devices", "Devices,,,").encode()]


def _campaigns(_: Path) -> list[bytes]:
    return [b"subjects:\n  - {subject: subject_1, bags: [.], hold_out: [..], name: anna, cases: {.: road}}\n"]


READERS: Final = {
    "mcap": Reader(".mcap", _bag, _bags),
    "cdr": Reader(".cdr", _cdr, lambda _: [bytes(_messages(1)[1][0])]),
    "subject": Reader(".yaml", load_subject, lambda _: [subject_file("subject_1").read_bytes()]),
    "limits": Reader(".yaml", load_limits, lambda _: [config_file("limits.yaml").read_bytes()]),
    "campaign": Reader(".yaml", load_campaign, _campaigns),
    "checkpoint": Reader(".json", _checkpoint, _checkpoints),
    "state": Reader(".json", _state, _states),
    "Capture.U": Reader(".csv", _capture_u, _exports_of_capture_u),
    "Nexus": Reader(".csv", _import, _exports_of_nexus),
    "parts of a trace": Reader(
        ".json", lambda path: dict(PartStore(path)),
        lambda _: [json.dumps({"schema": 1, "version": "0", "parts": {"fit a": [1, 2.5, {"b": None}]}}).encode()],
    ),
}  # fmt: skip


@contextmanager
def as_file(reader: Reader) -> Iterator[Callable[[bytes], object]]:
    """The reader as a function of bytes, by a temporary file."""
    with TemporaryDirectory() as directory:
        path = Path(directory) / f"given{reader.suffix}"

        def read(data: bytes) -> object:
            path.write_bytes(data)
            return reader.read(path)

        yield read
