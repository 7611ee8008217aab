"""Finds the files of the installation: configuration, subjects, bags, page and templates; no ROS import.

They lie in the source tree, or in share/biodyn_ros of wherever pip or colcon put the package.
"""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from biodyn_core.base.errors import InputError
from biodyn_core.base.suggestions import did_you_mean, did_you_mean_file
from biodyn_ros.base.files import exists
from biodyn_ros.base.wording import listed

SHARE: Final = Path("share") / "biodyn_ros"


def config_file(name: str) -> Path:
    """The configuration file of this name, such as `limits.yaml`."""
    return _find("config", name)


def bag_file(name: str) -> Path:
    """The bundled bag of this name, such as `short.mcap`."""
    return _find("bags", name)


def subject_names() -> list[str]:
    """The names of the bundled subjects."""
    return sorted(path.stem for path in (_root() / "config" / "subjects").glob("*.yaml"))


def subject_file(name_or_path: str | Path) -> Path:
    """The subject file at a path, or the bundled one of a bare name such as `subject_1`."""
    with contextlib.suppress(RuntimeError):  # `~name` of an unknown user
        path = Path(name_or_path).expanduser()
        bundled = _root() / "config" / "subjects" / f"{name_or_path}.yaml"
        if exists(path) and path.is_file():
            return path
        if path.name == str(name_or_path) and exists(bundled):
            return bundled
    there = subject_names()
    near = did_you_mean_file(name_or_path) or did_you_mean(Path(name_or_path).stem, there)
    raise InputError(f"no subject file {name_or_path}{near or ';'} bundled: {listed(there)}; give others by path")


def package_directory(name: str) -> Path:
    """The directory `page` or `templates` of this package."""
    path = Path(__file__).parents[1] / name
    if not path.is_dir():
        raise InputError(f"the installation is incomplete: {path} is missing")
    return path


def _find(kind: str, name: str) -> Path:
    directory = _root() / kind
    path = directory / name
    if path.exists():
        return path
    there = sorted(entry.name for entry in directory.glob("[!.]*"))
    raise InputError(f"no {name} in {directory}; there is {listed(there)}{did_you_mean(name, there)}")


def _root() -> Path:
    """The first root that holds the files of biodyn."""
    roots = list(_roots())
    for root in roots:
        if (root / "package.xml").is_file() and (root / "config").is_dir():
            return root
    raise InputError(f"none of {listed([str(root) for root in roots])} holds the files of biodyn; install it again")


def _roots() -> Iterator[Path]:
    # Resolved, because a symlinked build leads back to the source tree.
    here = Path(__file__).resolve()
    yield here.parents[2]
    # An installation keeps code and share below one prefix: a venv, ~/.local, /usr/local, --target or colcon's.
    # This prefix comes first, so that the code never reads the files of another version.
    yield from (parent / SHARE for parent in here.parents[2:])
    yield Path(sys.prefix) / SHARE
    yield from (Path(prefix) / SHARE for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix)
