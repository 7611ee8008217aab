"""The clean environment: cleared variables, an own domain, and a command run as if it had been run directly."""

import importlib.util
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from biodyn_ros.base import environment

ROOT = Path(__file__).resolve().parents[1]
WRAPPER = [sys.executable, "-m", "biodyn_ros.base.environment", "--"]


def polluted() -> dict[str, str]:
    """An environment that carries every variable that must go, each with a value that would do harm."""
    return {**os.environ, **dict.fromkeys(environment.CLEARED, "/nowhere"), "ROS_DOMAIN_ID": "250"}


def start(*command: str, **more: str) -> subprocess.Popen[str]:
    """The wrapper around a command, with pipes on all sides."""
    variables = {name: value for name, value in polluted().items() if name != "PYTHONHOME"}
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return subprocess.Popen([*WRAPPER, *command], cwd=ROOT, env={**variables, **more}, text=True, **pipes)


def test_every_variable_that_a_machine_may_carry_is_cleared() -> None:
    clean = environment.clean_environment({**polluted(), "KEPT": "1", environment.HELD: "250"})
    assert not set(clean) & {*environment.CLEARED, environment.HELD}
    assert clean["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"
    assert os.access(clean["ROS_LOG_DIR"], os.W_OK)
    assert clean["KEPT"] == "1"
    assert environment.clean_environment(clean) == clean


def test_scripts_of_the_interpreter_come_first_in_path(tmp_path: Path) -> None:
    clean = environment.clean_environment({"PATH": f"{tmp_path}{os.pathsep}/bin"})
    scripts, *others = clean["PATH"].split(os.pathsep)
    assert Path(scripts) == Path(sys.executable).parent
    assert others == [str(tmp_path), "/bin"]


def test_two_holders_have_different_domains(tmp_path: Path) -> None:
    with environment.hold_domain(tmp_path) as one, environment.hold_domain(tmp_path) as other:
        assert one.domain_id != other.domain_id
        assert {one.domain_id, other.domain_id} <= set(range(1, 102))


def test_a_released_domain_is_free_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(environment, "DOMAINS", range(7, 8))
    for _ in range(2):
        with environment.hold_domain(tmp_path) as domain:
            assert domain.domain_id == 7


def test_all_101_domains_can_be_held_and_then_no_more(tmp_path: Path) -> None:
    held = [environment.hold_domain(tmp_path) for _ in range(101)]
    assert {domain.domain_id for domain in held} == set(range(1, 102))
    try:
        with pytest.raises(environment.EnvironmentFault, match=r"\Ano free ROS domain: all of 1 to 101 .*\Z"):
            environment.hold_domain(tmp_path)
    finally:
        for domain in held:
            domain.release()


def test_a_directory_of_another_user_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(environment.tempfile, "gettempdir", lambda: str(tmp_path))
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / f"biodyn-{os.getuid()}").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(environment.EnvironmentFault, match="set TMPDIR"):
        environment.hold_domain()


def test_a_missing_lock_directory_is_reported_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(environment.tempfile, "gettempdir", lambda: str(tmp_path / "missing"))
    with pytest.raises(environment.EnvironmentFault, match=r"\Ano directory for locks and logs.*set TMPDIR.*\Z"):
        environment.hold_domain()


def test_a_prepared_environment_keeps_the_search_paths_and_reserves_a_domain() -> None:
    variables = polluted()
    variables.pop(environment.HELD, None)
    domain = environment.prepare(variables)
    assert domain is not None
    with domain:
        assert variables["ROS_DOMAIN_ID"] == variables[environment.HELD] == str(domain.domain_id)
        assert variables["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"
        assert variables["PYTHONPATH"] == "/nowhere"
        assert "RMW_IMPLEMENTATION" not in variables


def test_preparing_a_process_with_a_held_domain_changes_nothing() -> None:
    variables = {"ROS_DOMAIN_ID": "7", environment.HELD: "7", "PATH": "/bin"}
    assert environment.prepare(variables) is None
    assert variables == {"ROS_DOMAIN_ID": "7", environment.HELD: "7", "PATH": "/bin"}


def test_this_session_runs_in_a_held_domain() -> None:
    assert os.environ["ROS_DOMAIN_ID"] == os.environ[environment.HELD]
    assert os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"


def test_a_wrapped_command_starts_clean_and_keeps_its_domain_while_it_lives(tmp_path: Path) -> None:
    # Not Python, which sets LD_LIBRARY_PATH again if ROS is installed as wheels.
    with start("sh", "-c", "env && echo ready=1 && read line", TMPDIR=str(tmp_path)) as process:
        assert process.stdout is not None
        lines = list(iter(process.stdout.readline, "ready=1\n"))
        seen = dict(line.rstrip("\n").split("=", 1) for line in lines if "=" in line)
        domain_id = int(seen["ROS_DOMAIN_ID"])
        lock = tmp_path / f"biodyn-{os.getuid()}" / f"domain-{domain_id}.lock"
        assert domain_id in range(1, 102)
        assert not set(seen) & (set(environment.CLEARED) - {"ROS_DOMAIN_ID"})
        assert environment.try_lock(lock) is None
        process.communicate("end\n")
    descriptor = environment.try_lock(lock)
    assert descriptor is not None
    os.close(descriptor)


@pytest.mark.parametrize("code", [0, 1, 2, 7, 130])
def test_the_exit_code_is_returned(code: int) -> None:
    with start("sh", "-c", f"exit {code}") as process:
        assert process.communicate() == ("", "")
    assert process.returncode == code


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_a_signal_reaches_the_command(number: signal.Signals) -> None:
    script = f"trap 'echo caught; exit 43' {number.value}; echo ready; read line"
    with start("bash", "-c", script) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        process.send_signal(number)
        assert process.communicate()[0] == "caught\n"
    assert process.returncode == 43


def test_a_command_ended_by_a_signal_has_the_exit_code_of_the_signal() -> None:
    with start("sh", "-c", "kill -TERM $$") as process:
        process.communicate()
    assert process.returncode == -signal.SIGTERM


@pytest.mark.parametrize(
    ("command", "message"),
    [
        ((), "usage: python -m biodyn_ros.base.environment"),
        (("no-such-command",), "biodyn: cannot run no-such-command: No"),
    ],
)
def test_a_command_that_cannot_be_run_is_one_line_and_exit_code_2(command: tuple[str, ...], message: str) -> None:
    with start(*command) as process:
        output, errors = process.communicate()
    assert (process.returncode, output, errors.count("\n")) == (2, "", 1)
    assert errors.startswith(message)


@pytest.mark.skipif(importlib.util.find_spec("rclpy") is None, reason="ROS is not installed")
def test_rclpy_loads_in_the_command_although_the_machine_has_ros_variables() -> None:
    with start(sys.executable, "-c", "import rclpy, sensor_msgs.msg; rclpy.init(); print(rclpy.ok())") as process:
        output, errors = process.communicate()
    assert (process.returncode, output) == (0, "True\n"), errors
