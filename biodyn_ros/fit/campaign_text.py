"""A campaign as text for the terminal."""

from __future__ import annotations

from pathlib import Path

from biodyn_core.base.errors import InputError
from biodyn_core.base.wording import counted
from biodyn_ros.base.wording import number, table
from biodyn_ros.fit.campaign_results import CampaignReport


def text_of(report: CampaignReport) -> str:
    """The table of subjects for the terminal."""
    cells = [
        (row.name, row.state, number(row.mean_error_percent), number(row.seconds), str(len(row.bags)))
        for row in report.rows
    ]
    head, *lines = table([("subject", "state", "error, %", "seconds", "bags"), *cells], left=(0, 1))
    errors = [f"\n  {row.error}" if row.error else "" for row in report.rows]
    return "\n".join([head, *map(str.__add__, lines, errors)])


def check_failed(report: CampaignReport, directory: Path) -> None:
    """Raise InputError naming the subjects that failed, for exit code 2; all other results are written."""
    if failed := report.named("failed"):
        raise InputError(
            f"{len(failed)} of {counted(len(report.rows), 'subject')} failed: {', '.join(failed)}; "
            f"see {directory / 'campaign.json'}, --resume tries them again"
        )
