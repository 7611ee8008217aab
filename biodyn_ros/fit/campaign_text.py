"""A campaign as text for the terminal, from the mapping of campaign.json."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from biodyn_core.base.errors import InputError
from biodyn_core.base.wording import counted
from biodyn_ros.base.wording import number, table

Document = dict[str, Any]


def text_of(document: Document) -> str:
    """The table of subjects for the terminal."""
    rows = document["subjects"]
    cells = [
        (row["name"], row["state"], number(row["mean_error_percent"]), number(row["seconds"]), str(len(row["bags"])))
        for row in rows
    ]
    head, *lines = table([("subject", "state", "error, %", "seconds", "bags"), *cells], left=(0, 1))
    errors = [f"\n  {row['error']}" if row["error"] else "" for row in rows]
    return "\n".join([head, *(line + error for line, error in zip(lines, errors, strict=True))])


def check_failed(document: Document, directory: Path) -> None:
    """Raise InputError naming the subjects that failed, for exit code 2; all other results are written."""
    rows = document["subjects"]
    failed = [row["name"] for row in rows if row["state"] == "failed"]
    if failed:
        raise InputError(
            f"{len(failed)} of {counted(len(rows), 'subject')} failed: {', '.join(failed)}; "
            f"see {directory / 'campaign.json'}, --resume tries them again"
        )
