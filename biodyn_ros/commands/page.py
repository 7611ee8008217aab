"""`biodyn page`: the page of a live node, in a browser."""

from __future__ import annotations

import argparse

from biodyn_ros.commands.arguments import add_settings, settings_of
from biodyn_ros.commands.command import Command
from biodyn_ros.commands.parsing import CommandParser


def _add(command: CommandParser) -> None:
    from biodyn_ros.dashboard.settings import ServingSettings

    command.add_argument("--node", default="/biodyn", metavar="NAME", help="full name of the node (default /biodyn)")
    command.add_argument("--until-input-ends", action="store_true", help="stop when standard input ends, too")
    add_settings(command, "serving", ServingSettings, ("page_host", "page_port"))


def _run(options: argparse.Namespace) -> None:
    from biodyn_ros.dashboard.settings import ServingSettings, check_page

    check_page()
    from biodyn_ros.dashboard.site import serve  # an extra of its own

    def told(link: str) -> None:
        print(f"the page of {options.node}: {link}", flush=True)

    serve(options.node, settings_of(options, ServingSettings), told, options.until_input_ends)


COMMAND = Command(
    line="the page of a live node, in a browser",
    examples=(
        "biodyn page",
        "biodyn page --node /car/biodyn --page-port 8080",
    ),
    add=_add,
    run=_run,
    json=False,  # it serves, and has no result
)
