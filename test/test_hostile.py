"""Every reader takes a damaged or hostile file for what it is: one line, or what can be had of it; never more."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from biodyn_core.base.errors import MAX_CHARACTERS
from faults.hostile import LONGEST_S, MOST_BYTES, attacked, spoilt
from faults.readers import READERS, as_file

COUNT = 250


@pytest.mark.parametrize("name", READERS)
def test_what_is_good_is_read(name: str, tmp_path: Path) -> None:
    reader = READERS[name]
    with as_file(reader) as read:
        for data in reader.good(tmp_path):
            read(data)


@pytest.mark.parametrize("name", READERS)
def test_what_is_spoilt_is_one_line_at_most(name: str) -> None:
    lines = 0
    for one in attacked(name, COUNT, seed=1):
        assert "\n" not in one.said and len(one.said) <= MAX_CHARACTERS
        assert one.seconds < LONGEST_S and one.grown_bytes < MOST_BYTES
        lines += bool(one.said)
    assert lines > COUNT // 10  # otherwise nothing was spoilt


def test_spoiling_spoils_and_can_be_repeated() -> None:
    data = bytes(range(200))
    found = {spoilt(data, np.random.default_rng([3, number])) for number in range(100)}
    assert len(found) > 90 and spoilt(data, np.random.default_rng(5)) == spoilt(data, np.random.default_rng(5))
    assert spoilt(b"", np.random.default_rng(1)) == b""
