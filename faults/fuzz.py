"""Runs every reader under Atheris, a coverage-guided fuzzer; one process each, with limits on time and memory."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Final

NAMES: Final = (
    "mcap",
    "cdr",
    "subject",
    "limits",
    "campaign",
    "checkpoint",
    "state",
    "Capture.U",
    "Nexus",
    "parts of a trace",
)
MAX_MB: Final = 2048
MAX_INPUT_BYTES: Final = 16_384


def every(seconds: int) -> int:
    """Fuzz every reader for some seconds; returns 1 for an error other than InputError, 2 without Atheris."""
    if importlib.util.find_spec("atheris") is None:
        print("faults: fuzzing needs Atheris: pip install 'biodyn_ros[fuzz]'", file=sys.stderr)
        return 2
    failed = []
    for name in NAMES:
        with tempfile.TemporaryDirectory() as directory:
            words = [sys.executable, "-m", "faults.fuzz", name, str(seconds), directory]
            done = subprocess.run(words, text=True, capture_output=True, check=False, timeout=seconds + 300)
            last = [line for line in done.stderr.splitlines() if "DONE" in line or "cov:" in line]
            print(f"{name:18s} {'clean' if done.returncode == 0 else 'FAILED'}  {last[-1] if last else ''}", flush=True)
            if done.returncode != 0:
                failed.append(name)
                print(done.stderr[-3000:])
    return 1 if failed else 0


def one(name: str, seconds: int, directory: Path) -> None:
    """Fuzz one reader in this process; the fuzzer ends the process."""
    import atheris  # needs the extra `fuzz`

    import biodyn_core.body.effect_assembly  # noqa: F401 - compiled code cannot be instrumented, so it is loaded before

    with atheris.instrument_imports(include=["biodyn_core", "biodyn_ros", "yaml"]):
        from biodyn_core.base.errors import InputError
        from faults.readers import READERS, as_file
    reader, corpus = READERS[name], directory / "corpus"
    corpus.mkdir()
    for number, data in enumerate(reader.good(directory)):
        (corpus / str(number)).write_bytes(data)
    with as_file(reader) as read:

        def check(data: bytes) -> None:
            try:
                read(data)
            except InputError as error:
                if "\n" in str(error):
                    raise AssertionError(f"more than one line: {error}") from error

        limits = [f"-max_total_time={seconds}", f"-rss_limit_mb={MAX_MB}", f"-max_len={MAX_INPUT_BYTES}", "-timeout=10"]
        atheris.Setup([sys.argv[0], *limits, str(corpus)], check)
        atheris.Fuzz()


if __name__ == "__main__":
    one(sys.argv[1], int(sys.argv[2]), Path(sys.argv[3]))
