"""The command line: help that fits, examples that run, errors with a remedy, completion."""

from __future__ import annotations

import argparse
import dataclasses
import importlib.util
import json
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pages import empty_drawings
from session_bags import session_bag
from streams import noisy_streams
from trident import capture_u_files, nexus_text, shock, still

from biodyn_core.base.segments import SEAT
from biodyn_ros.bag import BagWriter
from biodyn_ros.bag.cdr import IMU_TYPE, encode_imu
from biodyn_ros.base import topics
from biodyn_ros.base.resources import config_file, subject_file, subject_names
from biodyn_ros.commands import fit, info, trace
from biodyn_ros.commands.cli import main, parsed
from biodyn_ros.commands.completion import script
from biodyn_ros.commands.parsing import CommandParser
from biodyn_ros.commands.table import GROUPS, NAMES, NESTED, command_of, parser
from biodyn_ros.node.params import names

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = [example for name in (*NAMES, *NESTED) for example in command_of(name).examples]
TOO_LONG = ("fit", "subject", "trace", "demo", "play", "live", "page")
"""Commands whose examples are parsed, not run: they take minutes, or never end."""

WITHOUT_JSON = {"demo", "live", "page", "compile", "completion"}


@pytest.fixture(autouse=True)
def _terminal_of_80_columns(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("COLUMNS", "80")
    with empty_drawings():
        yield


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    """Exit code, output and errors of a command."""
    code = 0
    try:
        code = main(list(arguments))
    except SystemExit as end:
        code = int(end.code or 0)
    output = capsys.readouterr()
    return code, output.out, output.err


# --- help ------------------------------------------------------------------------------------------------------------


def test_the_help_fits_a_screen_and_lists_every_command_once(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run(capsys, "--help")
    lines = out.rstrip("\n").split("\n")
    assert code == 0
    assert len(lines) <= 24
    assert max(map(len, lines)) <= 80
    listed = [name for names_of in GROUPS.values() for name in names_of]
    files = [path for path in (ROOT / "biodyn_ros/commands").glob("*.py") if "\nCOMMAND = Command(" in path.read_text()]
    known = [*listed, *(name.replace(" ", "-") for name in NESTED)]
    assert sorted(known) == sorted(path.stem.replace("_", "-") for path in files)
    assert max(len(command_of(name).line) for name in NAMES) <= 48  # beside a name as long as import-blue-trident
    rows = [match[1] for match in re.finditer(r"^  .{8}([a-z-]+) +\S", out, re.MULTILINE)]
    assert rows == listed
    assert out == run(capsys, "help")[1]


@pytest.mark.parametrize("name", NAMES)
def test_a_command_s_help_is_everyday_and_all_of_it_is_there_on_request(
    capsys: pytest.CaptureFixture[str], name: str
) -> None:
    code, short, _ = run(capsys, name, "-h")
    assert code == 0
    code, whole, _ = run(capsys, name, "--help-all")
    assert code == 0
    command = parser([name]).commands[name]
    tuning = {option for action in command.tuned for option in action.option_strings}
    options = {option for action in command.arguments for option in action.option_strings}
    shown = set(re.findall(r"(?<![\w-])--?[a-z][a-z0-9-]*", short.partition("\nexamples:")[0]))
    assert options - tuning <= shown
    assert not tuning & shown
    assert options <= set(re.findall(r"(?<![\w-])--?[a-z][a-z0-9-]*", whole))
    assert max(map(len, (short + whole).split("\n"))) <= 80
    assert len(short.split("\n")) <= 60
    assert (f"{len(command.tuned)} more setting" in short) == bool(command.tuned)
    assert 1 <= len(command_of(name).examples) <= 3
    unfolded = re.sub(r" \\\n +", " ", short)
    assert unfolded.endswith("examples:\n" + "".join(f"  {example}\n" for example in command_of(name).examples))


def test_every_tuning_setting_states_its_range_or_choices(capsys: pytest.CaptureFixture[str]) -> None:
    for name, command in parser().commands.items():
        for action in command.tuned:
            stated = action.nargs == 0 or action.choices or action.metavar == "TEXT" or " to " in action.help
            assert stated, (name, action.dest)


def test_every_choice_and_every_setting_that_is_on_states_its_default() -> None:
    for name, command in parser().commands.items():
        for action in command.arguments:
            chosen = bool(action.choices and action.option_strings)
            if chosen or isinstance(action, argparse.BooleanOptionalAction):
                assert "(default " in action.help, (name, action.dest)


def test_no_line_of_the_help_repeats_a_name(capsys: pytest.CaptureFixture[str]) -> None:
    _, out, _ = run(capsys, "--help")
    lines = [line.split()[:2] for line in out.splitlines() if line.startswith("  ")]
    assert lines and not [words for words in lines if words[0] == words[-1] and len(words) > 1]


def test_every_command_with_results_has_json() -> None:
    with_json = {
        name
        for name, command in parser().commands.items()
        if any("--json" in action.option_strings for action in command.arguments)
    }
    assert set(NAMES) - with_json == WITHOUT_JSON


# --- examples --------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory with the files that the examples name."""
    at = tmp_path_factory.mktemp("examples")
    write_bag(at / "drive.mcap")
    write_bag(at / "before.mcap", seed=6)
    for name in ("road", "road_2", "pothole", "rail", "rail_2"):
        (at / f"{name}.mcap").symlink_to(at / "drive.mcap")
    for name in ("anna", "anna_fitted"):
        shutil.copy(subject_file("subject_1"), at / f"{name}.yaml")
    shutil.copy(config_file("limits.yaml"), at / "limits.yaml")
    shutil.copy(config_file("live.yaml"), at / "live.yaml")
    for number, name in enumerate(("session", "session_2")):
        session_bag(at / f"{name}.mcap", number, ("road", "pothole"))
    (at / "conditions.csv").write_text("start,end,case\n0,9,gravel\n", encoding="utf-8")
    (at / "subjects.yaml").write_text("subjects: []\n", encoding="utf-8")
    for serial in ("TS-02374", "TS-02375"):
        capture_u_files(at / "exports", serial, shock())
    (at / "trial.csv").write_text(nexus_text({"TS-02374": still(500), "TS-02375": still(500)}), encoding="utf-8")
    (at / "sensors.yaml").write_text("seat: TS-02374\nhead: TS-02375\n", encoding="utf-8")
    motion = np.random.default_rng(1).normal([0.0, 0.0, 9.81], 1.0, (1500, 3))
    np.savetxt(at / "seat.csv", motion, delimiter=",", header="x,y,z", comments="")
    return at


def write_bag(path: Path, seed: int = 5) -> None:
    """The noisy streams on their topics, the seat on one that has to be mapped too."""
    with BagWriter(path) as writer:
        for stream in noisy_streams(seed=seed):
            payload = encode_imu(stream.stamps_ns, stream.accel_mps2, stream.gyro_radps, "imu")
            for topic in (topics.INPUT[stream.sensor], *(["/car/floor/imu"] if stream.sensor == SEAT else [])):
                writer.add_topic(topic, IMU_TYPE)
                writer.write(topic, stream.stamps_ns, payload)


def words_of(example: str) -> list[str]:
    """The arguments of an example, without redirections."""
    words = shlex.split(example.partition(" > ")[0])
    assert words[0] == "biodyn"
    return words[1:]


@pytest.mark.parametrize("example", [e for e in EXAMPLES if words_of(e)[0] not in TOO_LONG])
def test_the_example_runs(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, place: Path, example: str
) -> None:
    monkeypatch.chdir(place)
    words = words_of(example)
    if words[0] == "simulate" and "--case" in words:
        words[words.index("--seconds") + 1] = "2"
    code, out, errors = run(capsys, *words)
    assert code == 0, errors
    assert errors == ""
    if "--json" in words:
        assert json.loads(out)
    if "-o" in words:
        assert Path(words[words.index("-o") + 1]).exists()


@pytest.mark.parametrize("example", [e for e in EXAMPLES if words_of(e)[0] in TOO_LONG and words_of(e)[0] != "live"])
def test_the_example_is_parsed(monkeypatch: pytest.MonkeyPatch, place: Path, example: str) -> None:
    monkeypatch.chdir(place)
    words = words_of(example)
    options = parsed(words)
    assert all(Path(word).exists() for word in words if word.endswith(".mcap"))
    settings: dict[str, Callable[[Any], Any]] = {"fit": fit.how_of, "trace": trace.how_of}
    if words[0] in settings:
        how = settings[words[0]](options)
        assert list(how.held_out) == options.hold_out


def test_the_examples_of_the_live_node_name_existing_parameters(place: Path) -> None:
    from biodyn_ros.node.settings import SETTINGS

    for example in command_of("live").examples:
        words = words_of(example)
        assert words[:2] == ["live", "--ros-args"]
        for flag, value in zip(words[2::2], words[3::2], strict=True):
            known = {"-p": names(SETTINGS), "-r": set(topics.INPUT.values()), "--params-file": {"live.yaml"}}[flag]
            assert value.partition(":=")[0] in known


# --- errors ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("", "biodyn: no command is given; biodyn -h shows how"),
        ("replya drive.mcap", "biodyn: there is no command replya; did you mean replay? biodyn -h shows how"),
        ("simluate", "did you mean simulate?"),
        ("xyzzy", "biodyn: there is no command xyzzy; biodyn -h shows how"),
        ("--json replay", "biodyn: there is no option --json; biodyn -h shows how"),
        ("replay", "biodyn replay: the following arguments are required: BAG, --subject, -o/--output; "),
        ("replay drive.mcap --sbject subject_1 -o x", "there is no option --sbject; did you mean --subject?"),
        ("replay drive.mcap --subject=subject_1 --zerophase -o x", "no option --zerophase; did you mean --zero-phase?"),
        (
            "replay drive.mcap --subject subject_1 -o x --cutoff 50",
            "there is no option --cutoff; did you mean --cutoff-hz",
        ),
        ("replay drive.mcap more.mcap --subject subject_1 -o x", "unexpected: more.mcap"),
        ("replay drive.mcap --subject subject_1 -o", "argument -o/--output: expected one argument; biodyn replay -h"),
        ("replay drive.mcap --subject subjet_2 -o x", "no subject file subjet_2; did you mean subject_2? bundled:"),
        ("replay drive.mcap --subject subject_1 -o x --time lgo", "'lgo' is not one of header, log; did you mean log?"),
        ("replay drive.mcap --subject subject_1 -o x --window-s ten", "argument --window-s: 'ten' is not a number;"),
        (
            "simulate --subject subject_1 --case road --seed 1.5 -o x",
            "argument --seed: '1.5' is not a whole number >= 0;",
        ),
        ("simulate --subject subject_1 -o x.mcap", "one of the arguments --seat --case is required"),
        ("replay nothere.mcap --subject subject_1 -o x", "nothere.mcap: cannot be read (No such file or directory)"),
        ("replay drve.mcap --subject subject_1 -o x", "(No such file or directory); did you mean drive.mcap?"),
        ("replay drive.mcap --subject ana.yaml -o x", "did you mean anna.yaml?"),
        ("replay drive.mcap --subject subject_1 -o x --map sead=/car/floor/imu", "head; did you mean seat?"),
        ("replay drive.mcap --subject subject_1 -o x --map seat=/car/flor/imu", "did you mean /car/floor/imu?"),
        ("replay drive.mcap --subject subject_1 -o x --limits limit.yaml", "did you mean limits.yaml?"),
        ("simulate --subject subject_1 --case raod -o x.mcap", "did you mean road?"),
        ("simulate --subject subject_1 --case road --rate-hz 200 -o x", "allowed are 250 to 20000 Hz"),
        ("fit drive.mcap --subject anna.yaml -o y.yaml --case drve.mcap=road", "did you mean drive.mcap?"),
        ("replay seat.csv --subject subject_1 -o x", "seat.csv: "),
        ("replay drive.mcap --subject seat.csv -o x", "seat.csv: "),
        ("replay drive.mcap --subject subject_1 -o seat.csv", "seat.csv: is a file; the results need a directory"),
        ("replay drive.mcap --subject subject_1 -o /dev/null/x", "/dev/null: is a file; the results need a directory"),
        ("simulate --subject subject_1 --case road -o nowhere/x.mcap", "nowhere/x.mcap: cannot be written"),
        ("fit drive.mcap --subject subject_1 -o seat.csv", "seat.csv: a subject file ends in .yaml"),
        ("fit drive.mcap -o x.yaml", "BAG... and --subject are needed, or --campaign; biodyn fit -h shows how"),
        ("events drive.mcap -o x.json", "x.json: an events file ends in .yaml"),
        ("events drive.mcap -o x.yaml", "drive.mcap: no event in "),
        ("events drve.mcap -o x.yaml", "did you mean drive.mcap?"),
        ("events session.mcap -o x.yaml --cases marks", "session.mcap: has no marks: name conditions by the seat, or"),
        ("events session.mcap -o x.yaml --cases conditons.csv", "did you mean conditions.csv?"),
        (
            "events session.mcap session.mcap -o x.yaml",
            "the same recording as session.mcap; give it once",
        ),
        ("events session.mcap -o x.yaml --shock-g 99", "shock_g is 99, allowed are 0.1 to 50 g"),
        ("compile --subject nobody", "no subject file nobody"),
        ("replay drive.mcap@9..8 --subject subject_1 -o x", "needs an end at least 0.5 s after its start"),
        ("replay drive.mcap@900..901 --subject subject_1 -o x", "drive.mcap@900..901: outside the bag, which has "),
        ("fit drive.mcap --subject anna.yaml -o y.yaml --hold-out auto road.mcap", "name no further ones"),
        ("validate limits.yaml --subject anna.yaml", "limits.yaml: unknown key "),
        ("compare subject_1", "the following arguments are required: B; biodyn compare -h shows how"),
        ("completion bahs", "'bahs' is not one of bash, zsh, fish; did you mean bash?"),
        ("demo --json", "biodyn demo: there is no option --json; biodyn demo -h shows how"),
        ("live anna.yaml", "biodyn live: unexpected: anna.yaml; biodyn live -h shows how"),
        ("live --subject anna", "biodyn live: there is no option --subject; biodyn live -h shows how"),
    ],
)
def test_a_wrong_command_is_one_line_with_a_remedy(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, place: Path, line: str, message: str
) -> None:
    monkeypatch.chdir(place)
    before = sorted(path.name for path in place.iterdir())
    code, out, errors = run(capsys, *shlex.split(line))
    assert (code, out) == (2, "")
    assert message in errors
    assert errors.count("\n") == 1
    assert sorted(path.name for path in place.iterdir()) == before


def test_invalid_ros_arguments_are_reported_without_a_traceback(capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["live", "--ros-args", "-p", "foo"]) == 2
    _, errors = capfd.readouterr()
    assert "Couldn't parse parameter override rule: '-p foo'" in errors.splitlines()[-1]
    assert "Traceback" not in errors


# --- start -----------------------------------------------------------------------------------------------------------


def started(*arguments: str) -> subprocess.CompletedProcess[str]:
    """A command as a process of its own."""
    command = [sys.executable, "-m", "biodyn_ros.commands.cli", *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


LOADED_BY = """
import contextlib, json, sys
from biodyn_ros.commands.cli import main, parsed
for arguments in json.loads(sys.argv[1]):
    before = set(sys.modules)
    with contextlib.suppress(SystemExit):
        main(arguments)
    print(json.dumps([arguments, sorted(set(sys.modules) - before)]), file=sys.stderr)
"""


def loaded_by(*commands: list[str]) -> dict[str, set[str]]:
    """The modules that each command loads, in turn in one process; errors of one line are left out."""
    words = [sys.executable, "-c", LOADED_BY, json.dumps(commands)]
    ended = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True)
    lines = [json.loads(line) for line in ended.stderr.splitlines() if line.startswith("[[")]
    assert len(lines) == len(commands)
    return {" ".join(arguments): set(modules) for arguments, modules in lines}


def test_commands_without_computation_do_not_import_numpy() -> None:
    asked = [[name, how] for name in NAMES for how in ("-h", "--help-all")]
    heavy = {"numpy", "scipy", "numba", "rclpy", "matplotlib", "yaml"}
    found = loaded_by(["--version"], ["-h"], ["replya"], *asked)
    assert {command: modules & heavy for command, modules in found.items() if modules & heavy} == {}


def test_info_of_a_short_bag_loads_neither_numba_nor_the_slow_parts_of_scipy(place: Path) -> None:
    (modules,) = loaded_by(["info", str(place / "drive.mcap")]).values()
    assert "biodyn_core.kernels.sensor" in modules
    assert not {"numba", "scipy.signal", "scipy.optimize", "scipy.stats", "matplotlib", "rclpy"} & modules


def test_info_is_the_same_with_and_without_compilation(place: Path) -> None:
    code = "import sys; from biodyn_ros.commands import cli, info; info.UNCOMPILED_UP_TO ="
    words = ["info", str(place / "drive.mcap"), "--json"]
    loaded = "print('numba' in sys.modules, 'NUMBA_DISABLE_JIT' in __import__('os').environ, file=sys.stderr)"
    ended = [
        subprocess.run(
            [sys.executable, "-c", f"{code} {most}; cli.main({words!r}); {loaded}"],
            cwd=ROOT, capture_output=True, text=True, check=True,
        )
        for most in (0, 10**9)
    ]  # fmt: skip
    compiled, plain = ended
    assert plain.stderr == "False False\n"
    assert compiled.stderr == f"{importlib.util.find_spec('numba') is not None} False\n"
    rows, others = (json.loads(each.stdout)["topics"] for each in ended)
    for row, other in zip(rows, others, strict=True):
        # Contracted multiplications may differ in the last bit.
        assert [row.pop(key) for key in ("rate_hz", "jitter_ms")] == pytest.approx(
            [other.pop(key) for key in ("rate_hz", "jitter_ms")], rel=1e-12
        )
        assert row == other


# --- completion ------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def scripts(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The scripts of all shells, in files."""
    at = tmp_path_factory.mktemp("completion")
    for shell in ("bash", "zsh", "fish"):
        (at / shell).write_text(script(shell), encoding="utf-8")
    return at


COMPLETED = [
    ("biodyn re", {"replay"}),
    ("biodyn replay drive.mcap --time ", {"header", "log"}),
    ("biodyn fit --refine ", {"least-squares", "nelder-mead"}),
    ("biodyn simulate --case ", {"road", "pothole", "rail"}),
    ("biodyn completion ", {"bash", "zsh", "fish"}),
    ("biodyn replay ", {"drive.mcap", "directory"}),
    ("biodyn replay drive.mcap --subject ", {*subject_names(), "anna.yaml", "directory"}),
    ("biodyn compare subject_1 subject_2 --thr", {"--threshold"}),
    ("biodyn events ", {"drive.mcap", "directory"}),
    ("biodyn subject ", {"new", "drive.mcap", "directory"}),
    ("biodyn subject drive.mcap --per", {"--per-case"}),
    ("biodyn subject new --st", {"--stature"}),
]


@pytest.fixture
def files(tmp_path: Path) -> Path:
    """A directory with a bag, a subject, a text and a directory."""
    for name in ("drive.mcap", "anna.yaml", "notes.txt"):
        (tmp_path / name).touch()
    (tmp_path / "directory").mkdir()
    return tmp_path


@pytest.mark.parametrize(("line", "offered"), COMPLETED)
def test_bash_completes(scripts: Path, files: Path, line: str, offered: set[str]) -> None:
    words = [*line.split(), *([""] if line.endswith(" ") else [])]
    ask = (
        f"source {shlex.quote(str(scripts / 'bash'))}\nCOMP_WORDS=({shlex.join(words)})\n"
        f'COMP_CWORD={len(words) - 1}\n_shtab_biodyn\nprintf "%s\\n" "${{COMPREPLY[@]}}"'
    )
    ended = subprocess.run(["bash", "-c", ask], cwd=files, capture_output=True, text=True, check=True)
    assert set(ended.stdout.split()) == offered


@pytest.mark.parametrize(("line", "offered"), COMPLETED)
def test_fish_completes(scripts: Path, files: Path, line: str, offered: set[str]) -> None:
    if shutil.which("fish") is None:
        pytest.skip("fish is not installed")
    ask = f"source {shlex.quote(str(scripts / 'fish'))}; complete -C {shlex.quote(line)}"
    environment = {"HOME": str(files.parent), "PATH": "/usr/bin:/bin"}
    ended = subprocess.run(["fish", "-c", ask], cwd=files, env=environment, capture_output=True, text=True, check=True)
    found = {text.partition("\t")[0].rstrip("/") for text in ended.stdout.splitlines()}
    assert offered <= found  # fish itself offers other files behind them


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_completion_script_is_valid_and_starts_no_python(scripts: Path, shell: str) -> None:
    text = (scripts / shell).read_text(encoding="utf-8")
    assert "python" not in text.lower()
    assert all(name in text for name in (*NAMES, *subject_names()))
    if shutil.which(shell):
        subprocess.run([shell, "-n", str(scripts / shell)], check=True)


def test_without_shtab_the_error_names_the_package(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    code, out, errors = run(capsys, "completion", "bash")
    assert (code, out) == (2, "")
    assert errors == "biodyn completion: completion needs shtab: pip install 'biodyn_ros[completion]'\n"


def test_an_interruption_while_a_command_loads_is_one_line(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(command: CommandParser) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(info, "COMMAND", dataclasses.replace(info.COMMAND, add=interrupted))
    assert run(capsys, "info", "drive.mcap") == (130, "", "biodyn info: interrupted\n")
