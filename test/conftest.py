"""What every test finds: an own ROS domain on localhost, hypothesis without clocks, and the shared recordings."""

import os
import sys
from pathlib import Path

import pytest
from hypothesis import settings

from biodyn_ros import environment

ROOT = Path(__file__).resolve().parents[1]

# `make test` has done this already; here it is done for a bare `pytest`. rclpy reads these variables on import.
assert "rclpy" not in sys.modules
DOMAIN = environment.settle(os.environ)

# A deadline would measure the machine. Continuous integration tries the same examples each time.
settings.register_profile("biodyn", deadline=None, derandomize="CI" in os.environ)
settings.load_profile("biodyn")


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The recordings beside the checkout, which are too large for it."""
    directory = ROOT.parent / "shared" / "data"
    if not directory.is_dir():
        pytest.skip("the shared recordings are not beside this checkout, in ../shared/data")
    return directory
