"""`biodyn play`: publishes a bag on its topics."""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path

from biodyn_ros.commands.arguments import add_bag, add_settings, settings_of, show
from biodyn_ros.commands.command import Command
from biodyn_ros.commands.parsing import CommandParser
from biodyn_ros.progress import Progress


def _add(command: CommandParser) -> None:
    from biodyn_ros.playback import PlayerSettings

    add_bag(command)
    add_settings(command, "playing", PlayerSettings, ("rate", "loop", "clock", "keep_stamps", "wait_s"))


def _run(options: argparse.Namespace) -> None:
    from biodyn_ros.playback import PlayerSettings
    from biodyn_ros.player import play

    try:
        with Progress("playing") as progress:
            played = play(Path(options.bag), settings_of(options, PlayerSettings), progress)
    except KeyboardInterrupt:
        return
    count, topics = sum(played.messages.values()), len(played.messages)
    text = f"{options.bag}: {count} messages on {topics} topics in {played.seconds:.1f} s"
    show(options, dataclasses.asdict(played), text)


COMMAND = Command(
    line="publishes a bag, stamps rebased to now",
    examples=(
        "biodyn play drive.mcap",
        "biodyn play drive.mcap --rate 0.5 --loop",
    ),
    add=_add,
    run=_run,
)
