"""The blind studies: what only the world knows of people and of what is hidden in their records, told and looked up."""

import sys
from pathlib import Path

# The world shares nothing with the package, so it lives with the tests.
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "test"))
