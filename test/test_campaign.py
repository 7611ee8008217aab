"""Campaigns: the file, results in order of completion, and failures of single subjects."""

import dataclasses
import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import chores
import fitting
import pytest
import yaml
from expecting import refusal, until
from listed import assert_listed

from biodyn_core.base.errors import InputError
from biodyn_core.body.subject import load_subject
from biodyn_core.body.synthesis import SensorSettings
from biodyn_core.identification.phase1 import SwarmSettings
from biodyn_core.identification.settings import FitSettings
from biodyn_ros.commands import cli
from biodyn_ros.fit import campaign as campaigns
from biodyn_ros.fit import campaign_results as results
from biodyn_ros.fit.campaign import fit_campaign
from biodyn_ros.fit.campaign_file import Entry, load_campaign
from biodyn_ros.fit.campaign_results import SubjectFit
from biodyn_ros.fit.campaign_text import check_failed, text_of
from biodyn_ros.fit.document import fitted_subject
from biodyn_ros.fit.fitting import FitOptions, fit_bags
from biodyn_ros.reading.parts import BagPart
from biodyn_ros.simulate import motion_of_cases, simulate_bag
from biodyn_ros.work.executors import executor_of

QUICK = FitOptions(
    settings=FitSettings(swarm=SwarmSettings(particles=10, iterations=5, starts=1), evaluations=15, refined_starts=1)
)
QUICKLY = [
    "--particles", "10", "--iterations", "5", "--starts", "1", "--evaluations", "15", "--refined-starts", "1",
    "--no-report",
]  # fmt: skip
PEOPLE = ("anna", "ben", "carl")


@pytest.fixture(scope="module")
def field(tmp_path_factory) -> Path:
    """Three subject files, a bag of each, and the campaign of all."""
    directory = tmp_path_factory.mktemp("field")
    for seed, name in enumerate(PEOPLE):
        subject = fitting.drawn(seed, "segment")
        text = subject.to_yaml().replace(subject.name, name)
        (directory / f"{name}.yaml").write_text(text)
        motion = motion_of_cases(["road"], 4.0, seed)
        simulate_bag(directory / f"{name}.mcap", subject, motion, seed, SensorSettings(), "lz4")
    write(directory, [{"subject": f"{name}.yaml", "bags": [f"{name}.mcap"]} for name in PEOPLE])
    return directory


@pytest.fixture(scope="module")
def alone(field: Path) -> dict[str, str]:
    """The subject file of each, fitted by itself."""
    return {
        name: fitted_subject(fit_bags([field / f"{name}.mcap"], load_subject(field / f"{name}.yaml"), QUICK)).to_yaml()
        for name in PEOPLE
    }


def write(directory: Path, subjects: object) -> Path:
    """A campaign file."""
    path = directory / "campaign.yaml"
    path.write_text(yaml.safe_dump({"subjects": subjects}, sort_keys=False))
    return path


def written(directory: Path) -> dict[str, str]:
    """The subjects in a directory of results, without the paths of their bags, and whether campaign.json agrees."""
    document = json.loads((directory / "campaign.json").read_text())
    done = [row for row in document["subjects"] if row["state"] == "done"]
    assert sorted(row["result"] for row in done) == sorted(path.name for path in directory.glob("*.yaml"))
    for row in done:
        fit = json.loads((directory / f"{row['name']}.fit.json").read_text())
        assert (row["seconds"], row["mean_error_percent"]) == (fit["seconds"], fit["cases"][0]["joint"]["mean"])
    assert not list(directory.glob(".*"))
    return {row["name"]: (directory / row["result"]).read_text() for row in done}


# --- the file --------------------------------------------------------------------------------------------------------


def test_a_campaign_file_is_read(field: Path, tmp_path: Path) -> None:
    for name in ("one.mcap", "two.mcap"):
        (tmp_path / name).touch()
    path = write(
        tmp_path,
        [
            {"subject": "subject_1", "bags": ["one.mcap"], "cases": {"one.mcap": "gravel"}},
            {"subject": str(field / "anna.yaml"), "name": "anna 2", "bags": ["two.mcap"], "hold_out": ["one.mcap"]},
        ],
    )
    first, second = load_campaign(path).entries
    assert first.name == first.subject.name == "subject_1"
    assert first.bags == (str(tmp_path / "one.mcap"),) and first.cases == {str(tmp_path / "one.mcap"): "gravel"}
    assert (second.name, second.subject.name, second.held_out) == ("anna 2", "anna", first.bags)


GOOD = {"subject": "anna.yaml", "bags": ["anna.mcap"]}


@pytest.mark.parametrize(
    ("subjects", "fault"),
    [
        ([], r"subjects: expected a list of at least one subject"),
        ({}, r"subjects: expected a list of at least one subject"),
        ([3], r"subjects\[0\]: expected keys and values, got int"),
        ([GOOD | {"bag": 1}], r"subjects\[0\]: unknown key 'bag', known are subject, bags, name, hold_out, cases"),
        ([{"subject": "anna.yaml"}], r"subjects\[0\]: key 'bags' is missing"),
        ([GOOD, GOOD | {"subject": "nobody"}], r"subjects\[1\].subject: no subject file nobody; bundled:"),
        ([GOOD | {"subject": 3}], r"subjects\[0\].subject is 3, expected a text"),
        (
            [GOOD | {"subject": "anna.mcap"}],
            r"subjects\[0\].subject: /.*anna.mcap: larger than 1024 KiB, too large for such a file",
        ),
        ([GOOD | {"bags": []}], r"subjects\[0\].bags: anna has no bag, give at least one"),
        ([GOOD | {"bags": "anna.mcap"}], r"subjects\[0\].bags: expected a list of bags"),
        ([GOOD | {"bags": ["x.mcap"]}], r"subjects\[0\].bags\[0\]: there is no /.*/x.mcap: paths are relative to the"),
        ([GOOD | {"hold_out": [None]}], r"subjects\[0\].hold_out\[0\] is None, expected a text"),
        ([GOOD | {"bags": ["anna.mcap"] * 2}], r"subjects\[0\].bags\[1\]: anna.mcap is given twice"),
        ([GOOD | {"hold_out": ["./anna.mcap"]}], r"subjects\[0\]: /.*/anna.mcap is given twice; either fit to"),
        ([GOOD | {"cases": {"x": "road"}}], r"subjects\[0\].cases: unknown bag 'x', known are anna.mcap"),
        ([GOOD | {"cases": {"anna.mcap": 3}}], r"subjects\[0\].cases: anna.mcap is 3, expected a text"),
        ([GOOD | {"name": "../x"}], r"subjects\[0\].name: '../x' cannot be a file's"),
        ([GOOD | {"name": "x\ny"}], r"subjects\[0\].name is .x\\ny., expected one line"),
        ([GOOD | {"name": ".x"}], r"subjects\[0\].name: '.x' cannot be a file's"),
        ([GOOD, GOOD], r"subjects\[1\].name: anna is the result of subjects\[0\] too; set a name"),
        ([GOOD, GOOD | {"name": "ANNA"}], r"subjects\[1\].name: ANNA is the result of subjects\[0\] too; set a name"),
    ],
)
def test_a_campaign_file_with_a_fault_is_one_line(field: Path, tmp_path: Path, subjects, fault: str) -> None:
    for name in ("anna.yaml", "anna.mcap"):
        (tmp_path / name).symlink_to(field / name)
    refused(write(tmp_path, subjects), fault)


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("subjects: []\nsubjects: []", "subjects: given twice"),
        ("[", "not a YAML file"),
        ("[" * 5000, "not a YAML file"),
        ("more: 1\nsubjects: []", "the file: unknown key 'more', known are subjects"),
        ("", "the file: expected keys and values, got NoneType"),
    ],
)
def test_another_file_is_refused_in_one_line(tmp_path: Path, text: str, fault: str) -> None:
    (tmp_path / "campaign.yaml").write_text(text)
    refused(tmp_path / "campaign.yaml", fault)


@pytest.mark.parametrize(("key", "value"), [("body_mass_kg", 80.5), ("stature_m", 1.5), ("mass_matrix", "cascade")])
def test_one_person_is_the_same_in_all_entries(field: Path, tmp_path: Path, key: str, value: object) -> None:
    data = yaml.safe_load((field / "anna.yaml").read_text())
    (tmp_path / "other.yaml").write_text(yaml.safe_dump(data | {key: value}))
    bag = str(field / "anna.mcap")
    path = write(
        tmp_path,
        [
            {"subject": str(field / "anna.yaml"), "bags": [bag]},
            {"subject": "other.yaml", "name": "anna 2", "bags": [bag]},
        ],
    )
    refused(path, rf"subjects\[1\].subject: anna has {key} {value}, but .* in subjects\[0\]; one person has one")


def refused(path: Path, fault: str) -> None:
    """Assert that a campaign file is refused in one line that names it."""
    assert re.search(fault, refusal(load_campaign, path))


# --- the fits --------------------------------------------------------------------------------------------------------


def test_the_document_has_the_listed_keys() -> None:
    report = results.CampaignReport("campaign.yaml", (results.Row("anna", "anna", ["road.mcap"], []),))
    assert_listed("campaign.json", results.campaign_document(report))


def test_a_campaign_fits_each_subject_as_if_it_were_alone(field: Path, tmp_path: Path, alone) -> None:
    calls = []
    report = fit_campaign(
        load_campaign(field / "campaign.yaml"), tmp_path / "out", QUICK, progress=lambda *done: calls.append(done)
    )
    assert written(tmp_path / "out") == alone
    assert results.campaign_document(report) == json.loads((tmp_path / "out" / "campaign.json").read_text())
    assert calls == [(0, 3), (1, 3), (2, 3), (3, 3)]
    check_failed(report, tmp_path / "out")
    lines = text_of(report).splitlines()
    assert len(lines) == 4 and [line.split()[:2] for line in lines[1:]] == [[name, "done"] for name in PEOPLE]


@pytest.mark.slow  # processes run the same calls below, and test_work has a cluster
def test_a_campaign_runs_on_a_cluster(field: Path, tmp_path: Path, alone, cluster: str) -> None:
    with executor_of(cluster) as executor:
        fit_campaign(load_campaign(field / "campaign.yaml"), tmp_path, QUICK, executor)
    assert written(tmp_path) == alone


def test_a_subject_that_fails_does_not_stop_the_others(field: Path, tmp_path: Path, alone, capsys) -> None:
    (tmp_path / "bad.mcap").write_bytes((field / "ben.mcap").read_bytes()[:300])
    bags = {"anna": str(field / "anna.mcap"), "ben": "bad.mcap"}
    path = write(tmp_path, [{"subject": str(field / f"{name}.yaml"), "bags": [bag]} for name, bag in bags.items()])
    out = tmp_path / "out"
    command = ["fit", "--campaign", str(path), "-o", str(out), "--executor", "none", *QUICKLY]
    assert cli.main(command) == 2
    output = capsys.readouterr()
    assert output.err == (
        f"biodyn fit: 1 of 2 subjects failed: ben; see {out / 'campaign.json'}, --resume tries them again\n"
    )
    assert f"\n  {tmp_path / 'bad.mcap'}: " in output.out
    assert written(out) == {"anna": alone["anna"]}
    row = json.loads((out / "campaign.json").read_text())["subjects"][1]
    assert (row["state"], row["result"]) == ("failed", None) and "bad.mcap" in row["error"]

    # It is mended, and only it is fitted.
    (tmp_path / "bad.mcap").write_bytes((field / "ben.mcap").read_bytes())
    before = (out / "anna.yaml").stat().st_mtime_ns
    assert cli.main(command) == 2
    assert "campaign.json: holds a campaign; give --resume to continue it" in capsys.readouterr().err
    assert cli.main([*command, "--resume"]) == 0
    assert set(written(out)) == {"anna", "ben"} and (out / "anna.yaml").stat().st_mtime_ns == before


def test_an_impossible_profile_is_refused_before_a_campaign_begins(field: Path, tmp_path: Path, capsys) -> None:
    command = ["fit", "--campaign", str(field / "campaign.yaml"), "-o", str(tmp_path / "out"), "--executor", "none"]
    assert cli.main([*command, "--profile", "nonsense"]) == 2
    assert "profile: 'nonsense' is not a fitted parameter" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_terminated_worker_fails_one_subject_only(field: Path, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(campaigns, "fit_one", chores.fit_or_die)
    with executor_of("processes:1") as executor:
        report = fit_campaign(load_campaign(field / "campaign.yaml"), tmp_path, QUICK, executor)
    assert set(written(tmp_path)) == {"anna", "carl"}
    assert report.rows[1].error.startswith("ben: its worker process died, killed or out of memory")


def test_an_internal_error_does_not_stop_the_others(field: Path, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(campaigns, "fit_one", lambda entry, options, draw: {}[entry.name])
    report = fit_campaign(load_campaign(field / "campaign.yaml"), tmp_path, QUICK)
    assert [row.error for row in report.rows] == [f"KeyError: '{name}'" for name in PEOPLE]


def test_a_result_that_cannot_be_written_does_not_stop_the_others(field: Path, tmp_path: Path, monkeypatch) -> None:
    def fitted(entry: Entry, options: FitOptions, draw: bool) -> SubjectFit:
        fit = chores.fitted(entry)
        return dataclasses.replace(fit, document={"mean": float("inf")}) if entry.name == "ben" else fit

    monkeypatch.setattr(campaigns, "fit_one", fitted)
    (tmp_path / "carl.fit.json").mkdir()
    report = fit_campaign(load_campaign(field / "campaign.yaml"), tmp_path, QUICK)
    assert [row.state for row in report.rows] == ["done", "failed", "failed"]
    assert report.rows[1].error == "ValueError: Out of range float values are not JSON compliant: inf"
    assert "carl.fit.json: cannot be written" in report.rows[2].error
    assert [path.name for path in tmp_path.glob("*.yaml")] == ["anna.yaml"] and not (tmp_path / "ben.fit.json").exists()
    document = json.loads((tmp_path / "campaign.json").read_text())
    assert [row["state"] for row in document["subjects"]] == ["done", "failed", "failed"]


def test_a_result_of_another_fit_is_not_overwritten(field: Path, tmp_path: Path, monkeypatch) -> None:
    fitted = stand_ins(monkeypatch)
    campaign = load_campaign(field / "campaign.yaml")
    fit_campaign(campaign, tmp_path, QUICK)
    with pytest.raises(InputError, match=r"anna.yaml: is of another fit: .*; remove it to fit again, or give another"):
        fit_campaign(campaign, tmp_path, FitOptions(seed=1), resume=True)
    fit_campaign(campaign, tmp_path, QUICK, resume=True)
    assert fitted == list(PEOPLE)
    (tmp_path / "ben.yaml").unlink()
    fit_campaign(campaign, tmp_path, QUICK, resume=True)
    assert fitted == [*PEOPLE, "ben"]


def test_a_result_that_is_not_of_the_campaign_is_not_overwritten(field: Path, tmp_path: Path, monkeypatch) -> None:
    fitted = stand_ins(monkeypatch)
    campaign = load_campaign(field / "campaign.yaml")
    (tmp_path / "anna.yaml").write_text("of biodyn fit -o anna.yaml")
    expected = (
        r"anna.yaml: exists, but campaign.json does not list it as a result; remove it to fit again, or give another"
    )
    with pytest.raises(InputError, match=expected):
        fit_campaign(campaign, tmp_path, QUICK)
    assert [path.name for path in tmp_path.iterdir()] == ["anna.yaml"] and fitted == []
    (tmp_path / "anna.yaml").unlink()

    # An entry is dropped for one run, and added again.
    fit_campaign(campaign, tmp_path, QUICK)
    fit_campaign(dataclasses.replace(campaign, entries=campaign.entries[1:]), tmp_path, QUICK, resume=True)
    before = (tmp_path / "campaign.json").read_bytes()
    with pytest.raises(InputError, match=expected):
        fit_campaign(campaign, tmp_path, QUICK, resume=True)
    assert fitted == list(PEOPLE) and (tmp_path / "campaign.json").read_bytes() == before


@pytest.mark.parametrize("file", ["anna.fit.json", "anna.yaml", "anna.fit.html"])
def test_a_campaign_continues_after_an_interruption_while_it_wrote(
    field: Path, tmp_path: Path, monkeypatch, file: str
) -> None:
    """Interrupted twice: before Anna's row is done, after this file of hers is written."""
    fitted = stand_ins(monkeypatch)
    campaign = load_campaign(field / "campaign.yaml")
    with monkeypatch.context() as interrupted:
        for name in ("write_json", "write_text"):
            interrupted.setattr(results, name, interrupting(getattr(results, name), file))
        for resume in (False, True):
            with pytest.raises(KeyboardInterrupt):
                fit_campaign(campaign, tmp_path, QUICK, resume=resume)
            assert json.loads((tmp_path / "campaign.json").read_text())["subjects"][0]["state"] == "waiting"
    # With other options the file may be a complete result of the fit before.
    if (tmp_path / "anna.yaml").exists():
        with pytest.raises(InputError, match=r"anna.yaml: is of another fit"):
            fit_campaign(campaign, tmp_path, FitOptions(seed=1), resume=True)
    report = fit_campaign(campaign, tmp_path, QUICK, resume=True)
    assert len(report.named("done")) == 3 and fitted == ["anna", "anna", *PEOPLE]


def stand_ins(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Fits that take no time; the names of those that were called."""
    fitted: list[str] = []

    def fit_one(entry: Entry, options: FitOptions, draw: bool) -> SubjectFit:
        fitted.append(entry.name)
        return dataclasses.replace(chores.fitted(entry), page="page")

    monkeypatch.setattr(campaigns, "fit_one", fit_one)
    monkeypatch.setattr(results, "fingerprint", lambda entry, options: f"{entry.name} {options.seed}")
    return fitted


def interrupting(write: Callable[..., None], file: str) -> Callable[..., None]:
    """The function that writes, interrupted after this file."""

    def written(path: Path, *args: object, **more: object) -> None:
        write(path, *args, **more)
        if path.name == file:
            raise KeyboardInterrupt

    return written


def test_a_corrected_event_makes_another_fit(field: Path, tmp_path: Path) -> None:
    """Rest, its bag and the drift of clocks can be corrected in the events file, and change the fit."""
    entry = load_campaign(field / "campaign.yaml").entries[0]
    rest = tmp_path / "rest.mcap"
    rest.write_bytes((field / "ben.mcap").read_bytes())
    part = BagPart(field / "anna.mcap", 0.0, 3.0, rest_s=(0.0, 1.0), clock_ppm={"head": 12.4, "neck": 3.0})

    def of(one: BagPart) -> str:
        return results.fingerprint(dataclasses.replace(entry, bags=(one,)), QUICK)

    corrected = [
        dataclasses.replace(part, **change)
        for change in (
            {"rest_s": (0.0, 0.9)},
            {"rest_s": None},
            {"clock_ppm": {"head": 12.5}},
            {"rest_bag": rest},
            {"mapping": {}},
            {"time": "log"},
        )
    ]
    assert len({of(one) for one in [part, *corrected]}) == 7
    reordered = dataclasses.replace(part, clock_ppm={"neck": 3.0, "head": 12.4}, name="hit")
    assert of(reordered) == of(part)
    copy = tmp_path / "copy.mcap"
    copy.write_bytes(rest.read_bytes())
    assert of(dataclasses.replace(part, rest_bag=copy)) == of(corrected[3])


def test_results_do_not_overwrite_inputs(field: Path) -> None:
    with pytest.raises(InputError, match=r"anna.yaml: the campaign reads this file; name another directory"):
        fit_campaign(load_campaign(field / "campaign.yaml"), field, QUICK)


@pytest.mark.parametrize(
    "change",
    [
        lambda document: document.pop("schema"),
        lambda document: document.update(schema=2),
        lambda document: document.update(subjects={}),
        lambda document: document.update(subjects=[3]),
        lambda document: document["subjects"][0].pop("name"),
        lambda document: document["subjects"][0].update(name=[3]),
        lambda document: document["subjects"][0].update(bags=3),
        lambda document: document["subjects"][0].update(seconds="3"),
    ],
)
def test_a_damaged_campaign_json_is_one_line_and_stays(field: Path, tmp_path: Path, monkeypatch, change) -> None:
    monkeypatch.setattr(campaigns, "fit_one", lambda entry, options, draw: chores.fitted(entry))
    campaign, path = load_campaign(field / "campaign.yaml"), tmp_path / "campaign.json"
    document = results.campaign_document(fit_campaign(campaign, tmp_path, QUICK))
    change(document)
    path.write_text(json.dumps(document))
    before = path.read_bytes()
    with pytest.raises(InputError, match=r"^[^\n]*campaign.json: [^\n]*$"):
        fit_campaign(campaign, tmp_path, QUICK, resume=True)
    assert path.read_bytes() == before


@pytest.mark.slow
def test_an_interrupted_campaign_stores_finished_subjects(field: Path, tmp_path: Path, alone) -> None:
    """A real Ctrl-C: to every process of the terminal."""
    out = tmp_path / "out"
    arguments = ["fit", "--campaign", str(field / "campaign.yaml"), "-o", str(out), *QUICKLY]
    command = [sys.executable, "-m", "biodyn_ros.commands.cli", *arguments, "--executor", "processes:1"]
    with subprocess.Popen(command, start_new_session=True, stderr=subprocess.PIPE, text=True) as child:
        until(lambda: (out / "anna.yaml").exists() or child.poll() is not None)
        assert child.poll() is None
        os.killpg(child.pid, signal.SIGINT)
        assert (child.wait(20), child.stderr.read()) == (130, "biodyn fit: interrupted\n")
    states = {row["name"]: row["state"] for row in json.loads((out / "campaign.json").read_text())["subjects"]}
    assert states["carl"] == "waiting"
    before = (out / "anna.yaml").stat().st_mtime_ns
    assert cli.main([*arguments, "--executor", "none", "--resume"]) == 0
    assert written(out) == alone
    assert states["anna"] == "waiting" or (out / "anna.yaml").stat().st_mtime_ns == before
