"""`biodyn replay`: runs the live pipeline over a bag at full speed."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from biodyn_ros.base.progress import Progress
from biodyn_ros.commands.arguments import (
    Result,
    add_bag,
    add_map,
    add_settings,
    add_subject,
    add_time,
    run_each,
    settings_of,
)
from biodyn_ros.commands.command import Command
from biodyn_ros.commands.parsing import CommandParser

if TYPE_CHECKING:
    from biodyn_ros.reading.parts import Bag


def _add(command: CommandParser) -> None:
    from biodyn_core.conditioning.conditioning_settings import ConditioningSettings
    from biodyn_core.pipeline.pipeline_settings import PipelineSettings

    add_bag(command)
    add_subject(command)
    add_map(command)
    add_time(command)
    command.add_argument("--limits", metavar="FILE", help="limits file (default: 2002/44/EC)")
    command.add_argument(
        "--zero-phase", action="store_true", help="filter forward and backward, as in identification; results state it"
    )
    command.add_argument(
        "--project", action="store_true", help="project exposure to 8 h also from less than 20 minutes"
    )
    command.add_argument("--no-predicted", action="store_true", help="do not write predicted.mcap")
    command.add_argument("--no-report", action="store_true", help="do not write report.html")
    add_settings(command, "conditioning", ConditioningSettings)
    add_settings(command, "pipeline", PipelineSettings, ("yaw_deg", "vertical", "also_weighted", "window_s"))
    command.add_argument("-o", "--output", required=True, metavar="DIR", help="directory for the results")


def _run(options: argparse.Namespace) -> None:
    from biodyn_core.body.subject import load_subject
    from biodyn_core.conditioning.conditioning_settings import ConditioningSettings
    from biodyn_core.exposure.limits import EU_LIMITS, load_limits
    from biodyn_core.pipeline.pipeline_settings import PipelineSettings
    from biodyn_ros.base.resources import subject_file
    from biodyn_ros.reading.mapping import parse_map
    from biodyn_ros.replay.replaying import ReplayOptions, replay_to_directory

    how = ReplayOptions(
        mapping=parse_map(options.map),
        time=options.time,
        conditioning=settings_of(options, ConditioningSettings),
        pipeline=settings_of(options, PipelineSettings),
        limits=load_limits(options.limits) if options.limits else EU_LIMITS,
        mode="zero_phase" if options.zero_phase else "causal",
        project=options.project,
    )
    subject = load_subject(subject_file(options.subject))
    from biodyn_ros.replay.text import summary

    def run(bag: Bag, directory: Path | None) -> Result:
        assert directory is not None
        with Progress("replaying") as progress:
            replayed = replay_to_directory(
                bag, subject, directory, how, progress=progress, report=not options.no_report,
                predicted=not options.no_predicted,
            )  # fmt: skip
        return replayed.document, summary(replayed.report)

    run_each(options, Path(options.output), run)


COMMAND = Command(
    line="processes a bag: exposure, predictions, report",
    examples=(
        "biodyn replay drive.mcap --subject subject_1 -o results",
        "biodyn replay drive.mcap --subject anna.yaml -o results --yaw-deg 90 --limits limits.yaml",
        "biodyn replay drive.mcap --subject subject_1 -o results --no-predicted --no-report --json",
    ),
    add=_add,
    run=_run,
)
