"""What the help says of each command: its line, and examples that a test runs or parses; data, and nothing imported."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

PURPOSE: Final = "Six IMUs on a seated person in a vehicle: predicted motion, exposure, a model."


@dataclass(frozen=True)
class Help:
    """A command's line in the list of commands, 48 characters at most, and its examples, each as it is typed."""

    line: str
    examples: tuple[str, ...]


GROUPS: Final[dict[str, tuple[str, ...]]] = {
    "look": ("import-blue-trident", "info", "simulate", "demo"),
    "live": ("live", "page", "play"),
    "replay": ("replay",),
    "fit": ("fit", "compare", "validate"),
    "trace": ("trace",),
    "shell": ("completion",),
}
"""Every command once, in the order in which a person needs them."""

HELP: Final[dict[str, Help]] = {
    "import-blue-trident": Help(
        "CSV of Blue Trident sensors to one bag",
        (
            "biodyn import-blue-trident exports -o imported.mcap --map seat=TS-02374 --map head=TS-02375",
            "biodyn import-blue-trident trial.csv -o trial.mcap --map-file sensors.yaml --start 2026-05-12T10:32:00Z",
        ),
    ),
    "info": Help(
        "what a bag holds: rates, clocks, gaps, gravity",
        (
            "biodyn info drive.mcap",
            "biodyn info drive.mcap --map seat=/car/floor/imu",
        ),
    ),
    "simulate": Help(
        "a six-IMU bag from a subject and a seat motion",
        (
            "biodyn simulate --subject subject_2 --case rail --seconds 8 -o simulated.mcap",
            "biodyn simulate --subject anna.yaml --seat seat.csv --seat-rate 500 -o ride.mcap",
        ),
    ),
    "demo": Help(
        "the bundled bag live, and the same offline",
        ("biodyn demo --out demo_results",),
    ),
    "live": Help(
        "the live node; takes --ros-args",
        (
            "biodyn live --ros-args -p subject_file:=anna.yaml -p publish_measured:=true",
            "biodyn live --ros-args -r imu/seat/data:=/car/floor/imu",
            "biodyn live --ros-args --params-file live.yaml",
        ),
    ),
    "page": Help(
        "the page of a live node, in a browser",
        (
            "biodyn page",
            "biodyn page --node /car/biodyn --page-port 8080",
        ),
    ),
    "play": Help(
        "publishes a bag, stamps rebased to now",
        (
            "biodyn play drive.mcap",
            "biodyn play drive.mcap --rate 0.5 --loop",
        ),
    ),
    "replay": Help(
        "a bag offline: exposure, predictions, a report",
        (
            "biodyn replay drive.mcap --subject subject_1 -o results",
            "biodyn replay drive.mcap --subject anna.yaml -o results --yaw-deg 90 --limits limits.yaml",
            "biodyn replay drive.mcap --subject subject_1 -o results --no-predicted --no-report --json",
        ),
    ),
    "fit": Help(
        "recorded events to a subject, and how surely",
        (
            "biodyn fit road.mcap pothole.mcap rail.mcap --subject anna.yaml -o fitted.yaml --hold-out road_2.mcap",
            "biodyn fit road.mcap --subject anna.yaml -o fitted.yaml --case road.mcap=road --resume",
            "biodyn fit --campaign subjects.yaml -o fitted",
        ),
    ),
    "compare": Help(
        "which parameters two subjects share",
        (
            "biodyn compare subject_1 subject_2",
            "biodyn compare anna_fitted.yaml subject_2 --threshold 10 --json",
        ),
    ),
    "validate": Help(
        "predicts an event that was not fitted to",
        ("biodyn validate rail.mcap --subject anna_fitted.yaml -o results",),
    ),
    "trace": Help(
        "the effect that a subject's model lacks",
        (
            "biodyn trace road.mcap road_2.mcap rail.mcap rail_2.mcap --subject anna_fitted.yaml -o traced",
            "biodyn trace road.mcap rail.mcap --subject anna_fitted.yaml -o traced --hold-out road_2.mcap rail_2.mcap",
        ),
    ),
    "completion": Help(
        "prints a script that completes on your Tab key",
        (
            "biodyn completion bash > ~/.local/share/bash-completion/completions/biodyn",
            "biodyn completion zsh > ~/.zfunc/_biodyn",
        ),
    ),
}
