"""Every reader answers a damaged or hostile file with one line or the readable part, and nothing else."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from biodyn_core.base.errors import MAX_CHARACTERS
from faults.hostile import MAX_BYTES, MAX_S, attacked, mutated
from faults.readers import READERS, as_file

COUNT = 100


@pytest.mark.parametrize("name", READERS)
def test_valid_files_are_read(name: str, tmp_path: Path) -> None:
    reader = READERS[name]
    with as_file(reader) as read:
        for data in reader.good(tmp_path):
            read(data)


@pytest.mark.parametrize("name", READERS)
def test_damaged_files_give_one_line_at_most(name: str) -> None:
    lines = 0
    for one in attacked(name, COUNT, seed=1):
        assert "\n" not in one.message and len(one.message) <= MAX_CHARACTERS
        assert one.seconds < MAX_S and one.grown_bytes < MAX_BYTES
        lines += bool(one.message)
    assert lines > COUNT // 10  # otherwise nothing was spoilt


def test_damage_changes_the_file_and_repeats_with_the_seed() -> None:
    data = bytes(range(200))
    found = {mutated(data, np.random.default_rng([3, number])) for number in range(100)}
    assert len(found) > 90 and mutated(data, np.random.default_rng(5)) == mutated(data, np.random.default_rng(5))
    assert mutated(b"", np.random.default_rng(1)) == b""
