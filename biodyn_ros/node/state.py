"""The file that keeps exposure since reset across restarts of the live node: where it is, what of it is believed.

It is written beside its place and renamed, by a thread of its own, readable by its owner alone: it tells of a person's
health. One that is not gone on from is set aside, never overwritten.
"""

from __future__ import annotations

import itertools
import json
import os
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final, Literal

from biodyn_core.base.errors import InputError
from biodyn_core.body.subject import Subject
from biodyn_core.exposure.exposure_store import ExposureCheckpoint, digest
from biodyn_core.pipeline.pipeline import Pipeline
from biodyn_ros import __version__
from biodyn_ros.base.files import OWNER_ONLY, exists, make_directory, remove, state_directory, write_text
from biodyn_ros.base.json_files import keys_of, read_json

SCHEMA: Final = 4
ASIDE: Final = ".before"
NOWHERE: Final = "none"

Believed = Literal["fitting", "any", "none"]
BELIEVED: Final = ("fitting", "any", "none")


def state_path(given: str, node: str) -> Path | None:
    """The file that is meant: a path, nowhere, or where nothing is given, of the node's name where users keep state.

    Raises InputError where whoever runs the node has no home.
    """
    if given == NOWHERE:
        return None
    try:
        if given:
            return Path(given).expanduser()
        return state_directory() / f"{node.strip('/').replace('/', '.')}.json"
    except RuntimeError:
        raise InputError(f"state_file {given!r}: there is no home here, give a place") from None


class StateFile:
    """`read` once, `save` as often as one likes; raises InputError where the place cannot be written to."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._writer = ThreadPoolExecutor(max_workers=1, thread_name_prefix="biodyn state")
        self._writing: Future[None] | None = None
        if exists(path) and path.is_dir():  # it would be set aside as a damaged file, with all that is in it
            raise InputError(f"{path}: is a directory, state_file names a file")
        make_directory(path.parent)
        if not os.access(path.parent, os.W_OK):
            raise InputError(f"{path}: cannot be written (Permission denied)")

    def read(self) -> ExposureCheckpoint | None:
        """What is kept there; None where there is no file. Raises InputError, naming it, for one that is damaged."""
        if not exists(self.path):
            return None
        try:
            document = keys_of(read_json(self.path), "the file", ("schema", "version", "digest", "kept"))
            if document["schema"] != SCHEMA:
                raise InputError(f"schema is {str(document['schema'])[:40]}, this version reads {SCHEMA}")
            if document["digest"] != digest(document["kept"]):
                raise InputError("is damaged, its digest is of another content")
            return ExposureCheckpoint.from_dict(document["kept"])
        except InputError as error:
            raise InputError(f"{self.path}: {error}") from None

    def set_aside(self) -> Path:
        """Give what is there a name that nothing has, so that nothing is lost by what is written next; returns it."""
        names = (f"{self.path.name}{ASIDE}{number or ''}" for number in itertools.count())
        aside = next(path for name in names if not exists(path := self.path.with_name(name)))
        self.path.replace(aside)
        return aside

    def save(self, kept: ExposureCheckpoint) -> None:
        """Write in the background; left out while the last one is still being written."""
        if self._writing is None or self._writing.done():
            self._raised()
            self._writing = self._writer.submit(self._write, kept.to_dict())

    def remove(self) -> None:
        """Take away what is there, behind what is still being written."""
        self._writing = self._writer.submit(remove, self.path)

    def close(self, kept: ExposureCheckpoint | None) -> None:
        """Write for the last time, and wait for it."""
        self._writer.shutdown(wait=True)
        if kept is None:
            self._raised()
        else:
            self._write(kept.to_dict())

    def _raised(self) -> None:
        """Raise what the last writing met."""
        if self._writing is not None and self._writing.done():
            writing, self._writing = self._writing, None
            writing.result()

    def _write(self, kept: Mapping[str, Any]) -> None:
        document = {"schema": SCHEMA, "version": __version__, "digest": digest(kept), "kept": kept}
        write_text(self.path, json.dumps(document, allow_nan=False) + "\n", mode=OWNER_ONLY)


class ExposureStore:
    """Goes on from what was kept, at the first sample, and keeps what is counted from then on.

    belongs: of whom the exposure is; most_h: how much older, by its stamps, it may be than what comes.
    """

    def __init__(self, file: StateFile, belongs: Mapping[str, str], most_h: float, believed: Believed) -> None:
        self._file, self._belongs, self._most_h, self._believed = file, belongs, most_h, believed
        self.resumed, self.failed = False, ""
        self.waits = exists(file.path)
        """Whether the first sample is still to come that says what becomes of the file."""

    def begin(self, pipeline: Pipeline, sensor: str, stamp_ns: int) -> str:
        """The first sample has come: go on from the file, or set it aside; returns what became of it."""
        self.waits = False
        try:
            kept = self._file.read()
            age_h = (stamp_ns - kept.newest_of(sensor)) / 3.6e12 if kept else 0.0
            why = refused(kept, self._belongs, age_h, self._most_h, self._believed) if kept else "it is gone"
            if kept and not why:
                pipeline.resume(kept)
                self.resumed = True
                return f"exposure goes on from {self._file.path}"
        except InputError as error:
            why = str(error)
        return f"exposure begins anew: {why}; {self._set_aside()}"

    def reset(self) -> str:
        """Exposure starts anew: forget what is kept, also where nothing counts yet; returns what became of it, if much.

        What an earlier run kept, and nobody has gone on from yet, is set aside.
        """
        waits, self.waits, self.resumed = self.waits, False, False
        if waits:
            return self._set_aside()
        self._file.remove()
        return ""

    def _set_aside(self) -> str:
        try:
            return f"what was kept is in {self._file.set_aside()}"
        except OSError as error:
            return f"what was kept cannot be set aside ({error.strerror})"

    def keep(self, pipeline: Pipeline) -> None:
        """Keep what is counted so far, in the background; raises InputError where that failed."""
        kept = None if self.waits else pipeline.kept(self._belongs)
        if kept is not None:
            self._told(lambda: self._file.save(kept))

    def close(self, pipeline: Pipeline) -> None:
        """Keep what is counted for the last time; raises InputError where that failed."""
        kept = None if self.waits else pipeline.kept(self._belongs)
        self._told(lambda: self._file.close(kept))

    @property
    def path(self) -> Path:
        """The file."""
        return self._file.path

    def _told(self, write: Callable[[], None]) -> None:
        try:
            write()
            self.failed = ""
        except InputError as error:
            self.failed = str(error)
            raise


def belongs_to(subject: Subject, topics: Mapping[str, str]) -> dict[str, str]:
    """Of whom an exposure is: the person as the model has them, and which topic is which sensor."""
    person = {key: value for key, value in subject.to_dict().items() if key != "provenance"}
    return {"subject": digest(person), "sensors": digest(dict(topics))}


def refused(
    kept: ExposureCheckpoint, belongs: Mapping[str, str], age_h: float, most_h: float, believed: Believed
) -> str:
    """Why an exposure that was kept, so much older by its stamps, is not gone on from; empty where it is."""
    if believed == "none":
        return "kept_exposure is none"
    if believed == "any":
        return ""
    if foreign := kept.foreign_to(belongs):
        return f"it is of other {foreign}"
    if abs(age_h) > most_h:
        when = f"{age_h:.1f} h older" if age_h > 0.0 else f"{-age_h:.1f} h newer"
        return f"by its stamps it is {when} than what comes now, up to {most_h:g} h is gone on from"
    return ""
