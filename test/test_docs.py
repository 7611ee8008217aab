"""The guide step by step: its files are written and its commands are run, in their order; other pages are parsed."""

from __future__ import annotations

import dataclasses
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from pages import no_drawings
from streams import subject
from trident import capture_u_files, shock

from biodyn_core.body.subject import load_subject
from biodyn_core.body.synthesis import SensorSettings
from biodyn_core.identification.fit import fit_joint
from biodyn_core.identification.phase1 import SwarmSettings
from biodyn_core.tracing import trace
from biodyn_ros.base.environment import hold_domain
from biodyn_ros.base.resources import bag_file, subject_file
from biodyn_ros.commands.cli import main, parsed
from biodyn_ros.fit.campaign_file import load_campaign
from biodyn_ros.simulate import motion_of_cases, simulate_bag

ROOT = Path(__file__).resolve().parents[1]
GUIDE = ROOT / "docs" / "guide.md"
BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```$", GUIDE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
LONGEST_S = 280.0
SMALL = {
    "simulate": ["--seconds", "3"],
    "fit": ["--particles", "4", "--iterations", "2", "--starts", "1", "--refined-starts", "1", "--evaluations", "5"],
    "trace": ["--replicates", "20", "--refined", "2", "--generalised", "1"],
}
"""Options that make recordings and searches small; all else is as the page has it, also the executor where it is given,
but with one process."""

Capture = pytest.CaptureFixture[str]


def test_every_block_is_run_or_needs_other_machines() -> None:
    assert {kind for kind, _ in BLOCKS} == {"sh", "yaml", "text"}
    for kind, text in BLOCKS:
        if kind == "text":  # needs a robot, or other machines
            assert re.match(r"(ros2|dask) ", text)


@pytest.fixture
def desk(tmp_path: Path) -> Path:
    """An empty directory with exports of two sensors in it."""
    for seed, serial in enumerate(("TS-02374", "TS-02375")):
        capture_u_files(tmp_path / "exports", serial, shock(), seed=seed)
    return tmp_path


@pytest.fixture
def small_refits(monkeypatch: pytest.MonkeyPatch) -> None:
    """A trace refits theta by a small search, for which the command has no option."""

    def refitted(train: Any, subject: Any, seed: int, settings: Any, parallel: Any) -> Any:
        small = dataclasses.replace(settings, refined_starts=1, evaluations=20, swarm=SwarmSettings(8, 4, starts=1))
        return fit_joint(train, subject, seed, small, parallel)

    monkeypatch.setattr(trace, "fit_joint", refitted)


@pytest.mark.timeout(900)
def test_the_guide_can_be_followed(
    small_refits: None, desk: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.chdir(desk)
    for kind, text in BLOCKS:
        if kind == "yaml":
            name = re.match(r"# (\S+\.yaml)\n", text)
            assert name
            Path(name.group(1)).write_text(text)
        if kind == "sh" and "&\n" in text:
            run_as_processes(text)
        elif kind == "sh":
            run(text, capsys)
    check_outputs(desk)


def run(text: str, capsys: Capture) -> None:
    """Run the lines of a block in this process; what pages show is tested elsewhere."""
    for line in text.strip().splitlines():
        command, _, target = line.partition(">")
        capsys.readouterr()
        with no_drawings():
            code = main(arguments_of(command))
        output = capsys.readouterr()
        assert code == 0, f"{line}\n{output.err}"
        if target:
            Path(target.strip()).write_text(output.out)


def run_as_processes(text: str) -> None:
    """Run the lines of a block as processes in a ROS domain; lines that end in & run until the end of the block."""
    behind: list[subprocess.Popen[bytes]] = []
    with hold_domain() as domain:
        environment = os.environ | {"ROS_DOMAIN_ID": str(domain.domain_id), "PYTHONPATH": str(ROOT)}
        try:
            for line in text.strip().splitlines():
                call = [sys.executable, "-m", "biodyn_ros.commands.cli", *arguments_of(line.removesuffix("&"))]
                if line.endswith("&"):
                    behind.append(subprocess.Popen(call, env=environment))
                    continue
                done = subprocess.run(
                    call, env=environment, capture_output=True, text=True, timeout=LONGEST_S, check=False
                )
                assert done.returncode == 0, f"{line}\n{done.stderr}"
        finally:
            for process in behind:
                process.terminate()
                process.wait(30)


def arguments_of(command: str) -> list[str]:
    """The arguments of a biodyn command, patterns of files expanded, with the options of a small one."""
    program, *arguments = (word for part in shlex.split(command) for word in expanded(part))
    assert program == "biodyn"
    if arguments[0] in ("fit", "trace") and "--executor" not in arguments:
        arguments += ["--executor", "none"]
    return [*("processes:1" if word == "processes" else word for word in arguments), *SMALL.get(arguments[0], [])]


def expanded(word: str) -> list[str]:
    """The files that a pattern matches, as a shell expands it, or the word itself."""
    return sorted(str(path) for path in Path().glob(word)) or [word] if "*" in word else [word]


def test_the_subjects_of_the_guide_have_the_body_of_the_simulated_one() -> None:
    """Mass and stature in the files of the guide equal those of the subject that is simulated."""
    text = "".join(block for kind, block in BLOCKS if kind == "sh")
    drawn = [load_subject(subject_file(name)) for name in re.findall(r"biodyn simulate --subject (\S+)", text)]
    bodies = {(person.body_mass_kg, person.stature_m) for person in drawn}
    files = [yaml.safe_load(block) for kind, block in BLOCKS if kind == "yaml"]
    persons = [document for document in files if "body_mass_kg" in document]
    assert len(persons) == 2 and len(bodies) == 1
    assert {(person["body_mass_kg"], person["stature_m"]) for person in persons} == bodies


def check_outputs(desk: Path) -> None:
    assert json.loads((desk / "road_1.info.json").read_text())["topics"]
    assert (desk / "out" / "road_1" / "report.html").exists()
    exposure = json.loads((desk / "out" / "road_1" / "exposure.json").read_text())
    assert exposure["subject"] == "subject_2"
    assert json.loads((desk / "out" / "rail_2" / "validate.json").read_text())
    assert json.loads((desk / "out" / "anna_trace" / "trace.json").read_text())["verdict"] == "not_decidable"
    assert (desk / "fits" / "anna.yaml").exists()


# --- the other pages -------------------------------------------------------------------------------------------------

PAGES = ["README.md", "bags/README.md", *(f"docs/{page.name}" for page in sorted((ROOT / "docs").glob("*.md")))]


def commands(page: str) -> list[str]:
    """The commands of a page, continued lines joined, without comments and redirections."""
    text = (ROOT / page).read_text(encoding="utf-8").replace("\\\n", " ")
    lines = re.findall(r"^ {0,4}(biodyn [a-z].*)$", text, re.MULTILINE)
    return [re.split(r"\s+#|\s+&&|\s+>|\s+&$", line)[0] for line in lines]


@pytest.mark.parametrize("line", [pytest.param(line, id=line[:60]) for page in PAGES for line in commands(page)])
def test_every_command_of_every_page_is_parsed(line: str) -> None:
    words = shlex.split(line)[1:]
    parsed(words if words[0] != "live" else words[:1])


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_the_commands_of_the_tracing_protocol_run(
    small_refits: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    cases = ("road", "rail")
    drives = [f"{day}/{case}_{k}" for day in ("base", "null") for case in cases for k in (1, 2)]
    drives += [f"helmet/{case}_helmet_{k}" for case in cases for k in (1, 2)] + ["helmet/rail_helmet_9"]
    for seed, drive in enumerate(drives):
        (tmp_path / drive).parent.mkdir(exist_ok=True)
        case = next(case for case in cases if case in drive)
        motion = motion_of_cases([case], 3.0, seed)
        simulate_bag(tmp_path / f"{drive}.mcap", subject(), motion, seed, SensorSettings())
    known = yaml.safe_load(subject_file("subject_1").read_text(encoding="utf-8"))
    (tmp_path / "p01.yaml").write_text(yaml.safe_dump(known | {"name": "p01"}))
    monkeypatch.chdir(tmp_path)
    run("\n".join(commands("docs/recording_for_tracing.md")), capsys)
    for day in ("base", "null", "helmet"):
        # Too few and too short recordings: no verdict.
        assert json.loads((tmp_path / "out" / day / "trace.json").read_text())["verdict"] == "not_decidable"
    assert json.loads((tmp_path / "out" / "helmet_9" / "validate.json").read_text())["verdict"]


def test_the_pages_have_commands() -> None:
    with_commands = (
        "commands",
        "fitting",
        "guide",
        "import_blue_trident",
        "live_node",
        "recording_for_tracing",
        "tracing",
    )
    assert {page for page in PAGES if commands(page)} >= {"README.md", *(f"docs/{name}.md" for name in with_commands)}


def block_of(page: str, kind: str) -> str:
    """The only block of a kind on a page."""
    (block,) = re.findall(
        rf"^```{kind}\n(.*?)^```$", (ROOT / page).read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL
    )
    return block


def test_the_python_example_of_the_readme_gives_the_stated_values(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    block = block_of("README.md", "python")
    seat = np.sin(2 * np.pi * 4.0 * np.arange(2000) / 1129.3)
    *setup, modes, transmissibility, simulated = block.strip().splitlines()
    names = {"seat_mps2": seat}
    exec("\n".join(setup), names)  # noqa: S102 - our own page
    expected = [float(number) for number in re.findall(r"[\d.]+", modes.split("#")[1])]
    assert eval(modes, names) == pytest.approx(expected, rel=2e-3)  # noqa: S307 - our own page
    assert np.iscomplexobj(eval(transmissibility, names))  # noqa: S307 - our own page
    assert eval(simulated, names).shape == (2000, 6)  # noqa: S307 - our own page


def test_the_examples_of_effects_and_of_a_campaign_are_read(tmp_path: Path) -> None:
    effects, campaign = block_of("docs/effects.md", "yaml"), block_of("docs/fitting.md", "yaml")
    known = yaml.safe_load(subject_file("subject_1").read_text(encoding="utf-8"))
    (tmp_path / "with.yaml").write_text(yaml.safe_dump(known | yaml.safe_load(effects)))
    assert len(load_subject(tmp_path / "with.yaml").effects) == 2
    (tmp_path / "people.yaml").write_text(campaign)
    (tmp_path / "anna.yaml").write_text(subject_file("subject_1").read_text(encoding="utf-8"))
    (tmp_path / "anna").mkdir()
    for name in ("road_1", "pothole", "rail"):
        shutil.copy(bag_file("subject_1.mcap"), tmp_path / "anna" / f"{name}.mcap")
    assert load_campaign(tmp_path / "people.yaml")
