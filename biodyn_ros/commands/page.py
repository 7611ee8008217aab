"""`biodyn page`: serves the page of a live node for a browser."""

from __future__ import annotations

import argparse

from biodyn_ros.commands.arguments import add_settings, settings_of
from biodyn_ros.commands.command import Command
from biodyn_ros.commands.parsing import CommandParser


def _add(command: CommandParser) -> None:
    from biodyn_ros.dashboard.settings import ServingSettings

    command.add_argument("--node", default="/biodyn", metavar="NAME", help="full name of the node (default /biodyn)")
    command.add_argument("--until-input-ends", action="store_true", help="also stop when standard input ends")
    add_settings(command, "serving", ServingSettings, ("page_host", "page_port"))


def _run(options: argparse.Namespace) -> None:
    from biodyn_ros.dashboard.settings import ServingSettings, check_page

    check_page()
    from biodyn_ros.dashboard.site import serve  # needs the extra `page`

    def print_link(link: str) -> None:
        print(f"the page of {options.node}: {link}", flush=True)

    serve(options.node, settings_of(options, ServingSettings), print_link, options.until_input_ends)


COMMAND = Command(
    line="serves the page of a live node for a browser",
    examples=(
        "biodyn page",
        "biodyn page --node /car/biodyn --page-port 8080",
    ),
    add=_add,
    run=_run,
    json=False,  # it has no result
)
