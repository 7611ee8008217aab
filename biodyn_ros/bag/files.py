"""The files of a bag: those that metadata.yaml names, or those in the directory if metadata.yaml is not usable."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, cast

from biodyn_core.base.errors import InputError
from biodyn_core.base.yaml_files import read_yaml
from biodyn_ros.bag import mcap, sqlite
from biodyn_ros.bag.storage import refuse_foreign

_SUFFIXES = (".mcap", ".db3")
_ROS1 = "a ROS 1 bag, only ROS 2 bags can be read: convert it with rosbags-convert"


def kind_of(file: Path) -> str:
    """The storage of a file by its first bytes, "mcap" or "sqlite3"; InputError for anything else."""
    with file.open("rb") as stream:
        head = stream.read(16)
    if head.startswith(mcap.MAGIC):
        return "mcap"
    if head.startswith(sqlite.MAGIC):
        return "sqlite3"
    if head.startswith(b"#ROSBAG V"):
        raise InputError(f"{file}: {_ROS1}")
    if head.startswith(b"\x28\xb5\x2f\xfd"):
        raise InputError(f"{file}: the whole file is compressed: decompress it first (zstd -d) and open the result")
    if file.name.endswith(("-wal", "-shm")):
        raise InputError(f"{file}: part of the database {file.name[:-4]}: give that file")
    if not head:
        raise InputError(f"{file}: the file is empty")
    raise InputError(f"{file}: neither an MCAP nor a sqlite3 file: {_instead(file)}")


def _instead(file: Path) -> str:
    """The remedy for a file that is no bag, by its name."""
    name = file.name.lower()
    if name == "metadata.yaml":
        return "the metadata of a recording: give its directory"
    if name.endswith((".csv", ".txt")):
        return (
            "give a .mcap, a .db3 or a rosbag2 directory (for a table of a seat motion: 'biodyn simulate --seat'; for "
            "exports of Blue Trident sensors: 'biodyn import-blue-trident')"
        )
    if name.endswith((".gz", ".tgz", ".zip", ".bz2", ".xz", ".tar", ".7z")):
        return "an archive: unpack it, then give the .mcap, the .db3 or the rosbag2 directory in it"
    return "give a .mcap, a .db3 or a rosbag2 directory"


def files_of_directory(path: Path, warnings: list[str]) -> list[Path]:
    """The storage files of a recording in order; a file that metadata.yaml names and that is missing gives a warning.

    InputError for a directory without a bag, with several, or with one that is compressed or not CDR.
    """
    named = _named_files(path / "metadata.yaml", warnings)
    there = [file for file in named if file.is_file()]
    missing = [file.name for file in named if not file.is_file()]
    if there:
        warnings.extend(f"{path}: {name} is missing: its part of the recording is omitted" for name in missing)
        return there
    found = sorted((f for f in path.iterdir() if f.suffix in _SUFFIXES and f.is_file()), key=_stem_and_number)
    if not found:
        raise InputError(_why_none(path))
    if len({_stem_and_number(file)[0] for file in found}) > 1:
        names = ", ".join(file.name for file in found)
        raise InputError(f"{path}: several recordings, and no metadata.yaml that lists them: choose one of {names}")
    if missing:
        names = ", ".join(file.name for file in found)
        warnings.append(f"{path}: metadata.yaml names {missing[0]}, which is missing: {names} is read instead")
    return found


def _named_files(metadata: Path, warnings: list[str]) -> list[Path]:
    """The files that metadata.yaml names; none, with a warning, if it is damaged, as after a full disk.

    Only the last part of a name is used: old bags prepend their directory, and a name must not leave the directory.
    """
    if not metadata.is_file():
        return []
    try:
        info = cast(Any, read_yaml(metadata))["rosbag2_bagfile_information"]
        names = [Path(str(name)).name for name in info["relative_file_paths"]]
        formats = [_name_and_format(topic["topic_metadata"]) for topic in info["topics_with_message_count"]]
        mode = str(info.get("compression_mode") or "none").lower()
    except (InputError, KeyError, TypeError, AttributeError):
        warnings.append(f"{metadata}: not readable as rosbag2 metadata: all bag files in the directory are read")
        return []
    if mode != "none":
        raise InputError(
            f"{metadata}: compression by {mode} cannot be read: rewrite the bag with 'ros2 bag convert',"
            " without compression or as MCAP with compressed chunks"
        )
    refuse_foreign(metadata, formats, [])
    return [metadata.parent / name for name in names]


def _name_and_format(topic: dict[str, Any]) -> tuple[str, str]:
    return str(topic["name"]), str(topic["serialization_format"])


def _stem_and_number(file: Path) -> tuple[str, int]:
    """drive_2.mcap is ("drive", 2), so that it comes before drive_10.mcap."""
    match = re.fullmatch(r"(.*)_(\d+)", file.stem)
    return (match[1], int(match[2])) if match else (file.stem, -1)


def _why_none(path: Path) -> str:
    if any(path.glob("*.bag")):
        return f"{path}: {_ROS1}"
    if any(path.glob("*.zstd")):
        return f"{path}: whole files are compressed: decompress them first (zstd -d)"
    return f"{path}: no .mcap or .db3 file in this directory: give a bag file or its directory"
