"""Exposure store: the file that carries exposure since reset across restarts of the live node.

A thread of its own writes a temporary file and renames it. It concerns a person's health, so its owner alone can read
it. A file that is not continued is renamed, never overwritten. One node at a time has it: two would continue each
other's doses.
"""

from __future__ import annotations

import itertools
import json
import os
import weakref
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final, Literal

from biodyn_core.base.arrays import Integers
from biodyn_core.base.digests import digest
from biodyn_core.base.errors import InputError
from biodyn_core.body.subject import Subject
from biodyn_core.exposure.checkpoint import ExposureCheckpoint
from biodyn_core.pipeline.continued_exposure import ContinuedExposure
from biodyn_ros import __version__
from biodyn_ros.base.environment import EnvironmentFault, try_lock
from biodyn_ros.base.files import OWNER_ONLY, exists, make_directory, remove, state_directory, write_text
from biodyn_ros.base.json_files import keys_of, read_json
from biodyn_ros.node.first_stamps import FirstStamps

SCHEMA: Final = 6
BACKUP: Final = ".before"
NO_FILE: Final = "none"

Policy = Literal["fitting", "any", "none"]
POLICIES: Final = ("fitting", "any", "none")
"""Which stored exposure is continued: one of the same subject and sensors that is not too old, any, or none."""


def state_path(given: str, node: str, domain_id: int = 0) -> Path | None:
    """The path given, None for "none", or by default a file in the user's state directory.

    Its name is that of the node, and of its ROS domain if that is not 0.

    Raises InputError where the user has no home directory.
    """
    if given == NO_FILE:
        return None
    try:
        if given:
            return Path(given).expanduser()
        domain = f".domain_{domain_id}" if domain_id else ""
        return state_directory() / f"{node.strip('/').replace('/', '.')}{domain}.json"
    except RuntimeError:
        raise InputError(f"state_file {given!r}: there is no home directory, give a path") from None


class StateFile:
    """`read` once, `save` at will, `close`; raises InputError for a path that cannot be written or is in use."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._writer = ThreadPoolExecutor(max_workers=1, thread_name_prefix="biodyn state")
        self._writing: Future[None] | None = None
        if exists(path) and path.is_dir():  # else it would be renamed like a damaged file, with all its content
            raise InputError(f"{path}: is a directory, state_file names a file")
        make_directory(path.parent)
        if not os.access(path.parent, os.W_OK):
            raise InputError(f"{path}: cannot be written (Permission denied)")
        self._unlock = weakref.finalize(self, os.close, _lock(path))

    def read(self) -> ExposureCheckpoint | None:
        """The stored checkpoint; None without a file. Raises InputError, naming the file, where it is damaged."""
        if not exists(self.path):
            return None
        try:
            document = keys_of(read_json(self.path), "the file", ("schema", "version", "digest", "kept"))
            if document["schema"] != SCHEMA:
                raise InputError(f"schema is {str(document['schema'])[:40]}, this version reads {SCHEMA}")
            if document["digest"] != digest(document["kept"]):
                raise InputError("is damaged, its digest does not match its content")
            return ExposureCheckpoint.from_dict(document["kept"])
        except InputError as error:
            raise InputError(f"{self.path}: {error}") from None

    def back_up(self) -> Path:
        """Rename the file to a free name, so that the next `save` does not overwrite it; return that path."""
        names = (f"{self.path.name}{BACKUP}{number or ''}" for number in itertools.count())
        backup = next(path for name in names if not exists(path := self.path.with_name(name)))
        self.path.replace(backup)
        return backup

    def save(self, checkpoint: ExposureCheckpoint) -> None:
        """Write in the background; skipped while an earlier write still runs."""
        if self._writing is None or self._writing.done():
            self._raise_write_error()
            self._writing = self._writer.submit(self._write, checkpoint.to_dict())

    def remove(self) -> None:
        """Delete the file, after a write that still runs."""
        self._writing = self._writer.submit(remove, self.path)

    def close(self, checkpoint: ExposureCheckpoint | None) -> None:
        """Write for the last time, and wait until it is done."""
        self._writer.shutdown(wait=True)
        try:
            if checkpoint is None:
                self._raise_write_error()
            else:
                self._write(checkpoint.to_dict())
        finally:
            self._unlock()

    def _raise_write_error(self) -> None:
        """Raise the error of the last write, if any."""
        if self._writing is not None and self._writing.done():
            writing, self._writing = self._writing, None
            writing.result()

    def _write(self, checkpoint: Mapping[str, Any]) -> None:
        document = {"schema": SCHEMA, "version": __version__, "digest": digest(checkpoint), "kept": checkpoint}
        write_text(self.path, json.dumps(document, allow_nan=False) + "\n", mode=OWNER_ONLY)


def _lock(path: Path) -> int:
    try:
        descriptor = try_lock(path.with_name(f".{path.name}.lock"))
    except EnvironmentFault as error:
        raise InputError(f"{path}: {error}") from None
    if descriptor is None:
        raise InputError(f"{path}: another node stores its exposure there, give each node its own state_file")
    return descriptor


class ExposureStore:
    """Continue the stored exposure at the first samples, and store what is counted from then on.

    identity: of the exposure to continue, see `ExposureCheckpoint`; max_age_h: by the first stamps, see `FirstStamps`.
    pending: whether the file still awaits the first samples, which decide what becomes of it. resumed: whether it was
    continued. failure: the error of the last write, empty without one.
    """

    def __init__(self, file: StateFile, identity: Mapping[str, str], max_age_h: float, policy: Policy) -> None:
        self._file, self._identity, self._max_age_h, self._policy = file, identity, max_age_h, policy
        self._stored: ExposureCheckpoint | None = None
        self._first: FirstStamps | None = None
        self.resumed, self.failure = False, ""
        self.pending = exists(file.path)

    def begin(self, exposure: ContinuedExposure, sensor: str, stamps_ns: Integers) -> str:
        """Take first stamps (n,) ns until the exposure is continued, or its file renamed: return which, "" before.

        Samples are pushed into the exposure only after that.
        """
        if not stamps_ns.any():  # stamps of zero were never set
            return ""
        try:
            why = self._decided(sensor, stamps_ns)
            if why is None:
                return ""
            self.pending = False
            if self._stored is not None and not why:
                exposure.resume(self._stored)
                self.resumed = True
                return f"exposure continues from {self._file.path}"
        except InputError as error:
            why, self.pending = str(error), False
        return f"exposure starts at zero: {why}; {self._back_up()}"

    def _decided(self, sensor: str, stamps_ns: Integers) -> str | None:
        """Why the stored exposure is not continued, "" where it is, None while the stamps do not decide."""
        if self._first is None:
            self._stored = self._file.read()
            if self._stored is None:
                return "the file no longer exists"
            if self._policy != "fitting":
                return "" if self._policy == "any" else "kept_exposure is none"
            if differences := self._stored.differences(self._identity):
                return f"the stored exposure has other {differences}"
            self._first = FirstStamps(self._stored, self._max_age_h)
        return self._first.add(sensor, stamps_ns)

    def reset(self) -> str:
        """Exposure was reset: delete the file; return a message, empty where there is nothing to report.

        A file that is still pending is renamed instead.
        """
        pending, self.pending, self.resumed = self.pending, False, False
        if pending:
            return self._back_up()
        self._file.remove()
        return ""

    def _back_up(self) -> str:
        try:
            return f"the stored exposure is now in {self._file.back_up()}"
        except OSError as error:
            return f"the stored exposure cannot be renamed ({error.strerror})"

    def save(self, exposure: ContinuedExposure) -> None:
        """Store the exposure in the background; raises InputError where the last write failed."""
        if (checkpoint := self._checkpoint(exposure)) is not None:
            self._write(lambda: self._file.save(checkpoint))

    def close(self, exposure: ContinuedExposure) -> None:
        """Store the exposure for the last time; raises InputError where that fails."""
        checkpoint = self._checkpoint(exposure)
        self._write(lambda: self._file.close(checkpoint))

    @property
    def path(self) -> Path:
        """The file."""
        return self._file.path

    def _checkpoint(self, exposure: ContinuedExposure) -> ExposureCheckpoint | None:
        return None if self.pending else exposure.checkpoint(self._identity)

    def _write(self, write: Callable[[], None]) -> None:
        try:
            write()
            self.failure = ""
        except InputError as error:
            self.failure = str(error)
            raise


def identity_of(subject: Subject, topics: Mapping[str, str]) -> dict[str, str]:
    """The identity of an exposure: digests of the subject without provenance, and of the topic of each sensor."""
    person = {key: value for key, value in subject.to_dict().items() if key != "provenance"}
    return {"subject": digest(person), "sensors": digest(dict(topics))}
