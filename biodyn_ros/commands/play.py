"""`biodyn play`: publishes a bag on its topics."""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path

from biodyn_core.base.wording import counted
from biodyn_ros.base.progress import Progress
from biodyn_ros.commands.arguments import add_bag, add_map, add_settings, add_time, settings_of, show
from biodyn_ros.commands.command import Command
from biodyn_ros.commands.parsing import CommandParser


def _add(command: CommandParser) -> None:
    from biodyn_ros.play.player_settings import PlayerSettings

    add_bag(command)
    add_map(command)
    add_time(command)
    add_settings(command, "playing", PlayerSettings, ("rate", "loop", "clock", "keep_stamps", "wait_s"))


def _run(options: argparse.Namespace) -> None:
    from biodyn_ros.play.player import play
    from biodyn_ros.play.player_settings import PlayerSettings
    from biodyn_ros.reading.mapping import parse_map

    settings, mapping = settings_of(options, PlayerSettings), parse_map(options.map)
    try:
        with Progress("playing") as progress:
            played = play(Path(options.bag), settings, progress, mapping=mapping, time=options.time)
    except KeyboardInterrupt:
        return
    count, topics = sum(played.messages.values()), len(played.messages)
    text = f"{options.bag}: {counted(count, 'message')} on {counted(topics, 'topic')} in {played.seconds:.1f} s"
    show(options, dataclasses.asdict(played), text)


COMMAND = Command(
    line="publishes a bag with stamps shifted to now",
    examples=(
        "biodyn play drive.mcap",
        "biodyn play drive.mcap --rate 0.5 --loop",
        "biodyn play drive.mcap --map seat=/car/floor/imu",
    ),
    add=_add,
    run=_run,
)
