"""Blind studies: answers of the package about simulated people, compared with truths that only the simulation knows."""

import sys
from pathlib import Path

# The simulation (world) shares no code with the package, so it is beside the tests.
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "test"))
