"""The guide as a newcomer follows it: its files are written, its commands are run, in the order in which they stand."""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from trident import capture_u_files, shock

from biodyn_ros.environment import hold_domain

ROOT = Path(__file__).resolve().parents[1]
GUIDE = ROOT / "docs" / "guide.md"
BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```$", GUIDE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
LONGEST_S = 280.0


def test_every_block_is_run_or_says_why_not() -> None:
    assert {kind for kind, _ in BLOCKS} == {"sh", "yaml", "text"}
    for kind, text in BLOCKS:
        if kind == "text":  # what needs a robot, or other machines
            assert re.match(r"(ros2|dask) ", text)


def test_links_lead_somewhere() -> None:
    for page in (ROOT / "docs").glob("*.md"):
        for path in re.findall(r"\]\(([^)#:]+)[^)]*\)", page.read_text(encoding="utf-8")):
            assert (page.parent / path).exists(), f"{page.name}: {path}"


@pytest.fixture
def desk(tmp_path: Path) -> Path:
    """An empty directory with exports of two sensors in it."""
    for seed, serial in enumerate(("TS-02374", "TS-02375")):
        capture_u_files(tmp_path / "exports", serial, shock(), seed=seed)
    return tmp_path


@pytest.mark.timeout(900)
def test_the_guide_can_be_followed(desk: Path) -> None:
    with hold_domain() as domain:
        environment = os.environ | {"ROS_DOMAIN_ID": str(domain.domain_id), "PYTHONPATH": str(ROOT)}
        for kind, text in BLOCKS:
            if kind == "yaml":
                name = re.match(r"# (\S+\.yaml)\n", text)
                assert name
                (desk / name.group(1)).write_text(text)
            if kind == "sh":
                run(text, desk, environment)
    what_it_promises_is_there(desk)


def run(text: str, desk: Path, environment: dict[str, str]) -> None:
    """Run a block's lines; those that end in & go on until the block has ended."""
    behind: list[subprocess.Popen[bytes]] = []
    try:
        for line in text.strip().splitlines():
            command, _, target = line.removesuffix("&").partition(">")
            program, *arguments = shlex.split(command)
            assert program == "biodyn"
            call = [sys.executable, "-m", "biodyn_ros.cli", *arguments]
            if line.endswith("&"):
                behind.append(subprocess.Popen(call, cwd=desk, env=environment))
                continue
            done = subprocess.run(
                call, cwd=desk, env=environment, capture_output=True, text=True, timeout=LONGEST_S, check=False
            )
            assert done.returncode == 0, f"{line}\n{done.stderr}"
            if target:
                (desk / target.strip()).write_text(done.stdout)
    finally:
        for process in behind:
            process.terminate()
            process.wait(30)


def what_it_promises_is_there(desk: Path) -> None:
    assert json.loads((desk / "road_1.info.json").read_text())["topics"]
    assert (desk / "out" / "road_1" / "report.html").exists()
    exposure = json.loads((desk / "out" / "road_1" / "exposure.json").read_text())
    assert exposure["subject"] == "subject_2"
    assert json.loads((desk / "out" / "rail_2" / "validate.json").read_text())
    assert json.loads((desk / "out" / "anna_trace" / "trace.json").read_text())["verdict"] == "not_decidable"
    assert (desk / "fits" / "anna.yaml").exists()
