"""`python -m blind population`: derive the population, compare it with the references, write docs/people.md.

The exit code is 1 for a missed mark. With --keep the population of the package is compared, and not derived again.
"""

from __future__ import annotations

import argparse
import datetime as dt
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from biodyn_core.body.subject import load_subject
from biodyn_core.population import population as store
from biodyn_core.population.beside import beside_people
from biodyn_core.population.population import new_subject, to_text
from blind.population import head, softening
from blind.population.coverage import covered
from blind.population.deriving import BODY_MASS_KG, Derivation, derive
from blind.population.page import Study, marks, rendered
from blind.requirements import publish

ROOT: Final = Path(__file__).resolve().parents[2]
PAGE: Final = ROOT / "docs" / "people.md"
POPULATION: Final = Path(store.__file__).with_name(store.FILE)
PAPER: Final = ("subject_1", "subject_2")


def study(people: int) -> Study:
    """All results for the population of the package; people: drawn for the coverage."""
    mean = new_subject("mean of the population", BODY_MASS_KG, 1.75)
    printed = [load_subject(ROOT / "config" / "subjects" / f"{name}.yaml") for name in PAPER]
    subjects = [beside_people(one) for one in (mean, *printed)]
    return Study(store.population(), subjects, covered(people), head.rows(), softening.rows(Derivation()))


def main(arguments: Sequence[str]) -> int:
    """Run the whole study."""
    parser = argparse.ArgumentParser(prog="python -m blind population")
    parser.add_argument("--keep", action="store_true", help="keep the population of the package")
    parser.add_argument("--people", type=int, default=200, metavar="N", help="people drawn for coverage (default 200)")
    options = parser.parse_args(arguments)
    if not options.keep:
        POPULATION.write_text(to_text(derive(Derivation())), encoding="utf-8")
        store.population.cache_clear()
    found = study(options.people)
    today = dt.datetime.now(tz=dt.timezone.utc).date().isoformat()
    return publish(PAGE, rendered(found, today), marks(found))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
