"""Pages: HTML files from templates, with embedded drawings; a failure does not affect other results.

jinja2 and matplotlib are imported on use, because other functions do not need them.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from biodyn_core.base.errors import InputError, one_line
from biodyn_ros.base.files import remove, write_text
from biodyn_ros.base.resources import package_directory
from biodyn_ros.base.wording import (
    bound,
    dri_band,
    duration,
    ends,
    number,
    partly_tested,
    sentence,
    span,
    typeset,
    words,
)
from biodyn_ros.reports.drawing import PALETTE
from biodyn_ros.reports.verdict import shocks


def check_reports() -> None:
    """Raise InputError if a package for reports is missing, before a long computation."""
    for name in ("jinja2", "matplotlib"):
        if importlib.util.find_spec(name) is None:
            raise InputError(f"reports need {name}: pip install 'biodyn_ros[reports]', or use --no-report")


def render(template: str, **values: Any) -> str:
    """Render a template; values are escaped."""
    return typeset(_templates().get_template(template).render(palette=PALETTE, **values))


@cache
def _templates() -> Any:
    """The templates, of which each is compiled once: to compile them takes longer than to fill them."""
    import jinja2

    # Selection by file name would not escape templates that end in .j2.
    page = jinja2.Environment(
        loader=jinja2.FileSystemLoader(package_directory("templates")),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    page.filters.update(number=number, bound=bound, duration=duration, words=words, sentence=sentence, shocks=shocks)
    page.filters.update(span=span, ends=ends, dri_band=dri_band, partly_tested=partly_tested)
    page.filters["value"] = lambda stated: number(None) if stated is None else f"{stated:g}"
    return page


def write_drawn(path: Path, draw: Callable[[], str]) -> None:
    """Write a page after its results; if that fails, remove an older page."""
    try:
        # A file name that is not UTF-8 contains lone surrogates, which the page shows as escapes.
        write_text(path, draw(), errors="backslashreplace")
    except InputError:
        remove(path)
        raise
    except Exception as error:  # a defect in a drawing must not lose the results
        remove(path)
        raise InputError(
            f"{path}: cannot be drawn ({one_line(error)}); all other results are written; --no-report omits the page"
        ) from error
