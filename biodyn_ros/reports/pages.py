"""Pages: templates to HTML files that hold their drawings; whatever is written beside them stays if they cannot be.

jinja2 and matplotlib come late: whoever wants no report needs neither.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from pathlib import Path
from typing import Any

from biodyn_core.base.errors import InputError, one_line
from biodyn_ros.base.files import remove, write_text
from biodyn_ros.base.resources import package_directory
from biodyn_ros.base.wording import bound, duration, number, sentence, shocks, span, typeset, words
from biodyn_ros.reports.drawing import PALETTE


def check_reports() -> None:
    """Raise InputError where a report could not be drawn, so that a long replay can say so before it begins."""
    for name in ("jinja2", "matplotlib"):
        if importlib.util.find_spec(name) is None:
            raise InputError(
                f"reports need {name}: pip install 'biodyn_ros[reports]', or leave them out with --no-report"
            )


def render(template: str, **values: Any) -> str:
    """The page that a template makes of values; what comes from outside is text and nothing else."""
    import jinja2

    # Autoescape by name would miss templates that end in .j2.
    page = jinja2.Environment(
        loader=jinja2.FileSystemLoader(package_directory("templates")),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    page.filters.update(number=number, bound=bound, duration=duration, words=words, sentence=sentence, shocks=shocks)
    page.filters["span"] = span
    page.filters["value"] = lambda stated: number(None) if stated is None else f"{stated:g}"
    return typeset(page.get_template(template).render(palette=PALETTE, **values))


def write_drawn(path: Path, draw: Callable[[], str]) -> None:
    """Write a page whose results are written already; where it cannot be, no older one is left beside them."""
    try:
        # A file name that is not UTF-8 comes as lone surrogates, which the page shows as escapes.
        write_text(path, draw(), errors="backslashreplace")
    except InputError:
        remove(path)
        raise
    except Exception as error:  # a fault of ours in a drawing must not cost the results of hours
        remove(path)
        raise InputError(
            f"{path}: cannot be drawn ({one_line(error)}); all other results are there, --no-report leaves it out"
        ) from error
