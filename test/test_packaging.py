"""pip and colcon install the package, and the installation finds its files from any directory."""

import ast
import dataclasses
import os
import re
import runpy
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable
from configparser import ConfigParser
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree as ET

import pytest
import yaml
from ordering import SLOW

import biodyn_ros
from biodyn_core.base.errors import InputError
from biodyn_ros.base import resources
from biodyn_ros.base.environment import clean_environment
from biodyn_ros.commands.table import parser

ROOT = Path(__file__).resolve().parents[1]

# Prints every file that resources finds; run where neither the source tree nor its tests can be seen by accident.
FIND_ALL = """
import biodyn_ros, biodyn_core
from biodyn_ros.base import resources
from biodyn_ros.commands.table import parser
print(biodyn_ros.__file__)
print(biodyn_core.__file__)
for path in sorted(resources.config_file("subjects").parent.glob("*.yaml")):
    print(resources.config_file(path.name))
for name in resources.subject_names():
    print(resources.subject_file(name))
"""


@dataclass(frozen=True)
class Installed:
    """One way of installing: its prefix, where its scripts are, and the shell line that makes it known."""

    prefix: Path
    scripts: Path
    setup: str

    def run(self, command: str, cwd: Path) -> str:
        """Output of a command in a shell with the installation alone."""
        return run(["bash", "-c", f"{self.setup}\n{command}"], cwd)


def run(command: list[str], cwd: Path, **more: str) -> str:
    """Output of a command in a clean environment; its errors if it fails."""
    environment = {**clean_environment(os.environ), "PIP_NO_INPUT": "1", **more}
    done = subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{shlex.join(command)}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def copy_of_the_tree(target: Path) -> Path:
    """The files of a clone, with uncommitted changes."""
    listed = run(["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"], ROOT)
    for name in filter(None, listed.split("\0")):
        if (ROOT / name).is_file():
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, target / name)
    return target


def colcon(tmp_path: Path, *options: str) -> Installed:
    """The tree built with colcon in a workspace of its own."""
    tree = copy_of_the_tree(tmp_path / "src" / "biodyn")
    # The interpreter that runs colcon is the one in the executables. Its own home excludes a user's defaults.
    build = [sys.executable, "-m", "colcon", "build", "--base-paths", str(tree), *options]
    run(build, tmp_path, COLCON_HOME=str(tmp_path / "home"))
    prefix = tmp_path / "install" / "biodyn_ros"
    return Installed(prefix, prefix / "lib" / "biodyn_ros", f". {shlex.quote(str(tmp_path / 'install/setup.bash'))}")


def pip(tmp_path: Path, option: str) -> Installed:
    """The tree installed with pip below a directory, without its dependencies."""
    tree, prefix = copy_of_the_tree(tmp_path / "tree"), tmp_path / "prefix"
    options = ["--quiet", "--no-deps", "--no-build-isolation", "--ignore-installed", option, str(prefix)]
    run([sys.executable, "-m", "pip", "install", *options, str(tree)], tmp_path)
    (package,) = prefix.rglob("biodyn_ros/base/resources.py")
    setup = f"export PYTHONPATH={shlex.quote(str(package.parents[2]))}"
    shutil.rmtree(tree)
    return Installed(prefix, prefix / "bin", setup)


@pytest.fixture(scope="module")
def symlinked(tmp_path_factory: pytest.TempPathFactory) -> Installed:
    return colcon(tmp_path_factory.mktemp("symlinked"), "--symlink-install")


@pytest.fixture(
    scope="module",
    params=["colcon", "colcon-symlink", "pip-prefix", pytest.param("pip-target", marks=pytest.mark.slow)],
)
def installed(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Installed:
    if request.param == "colcon-symlink":
        return request.getfixturevalue("symlinked")
    tmp_path = tmp_path_factory.mktemp(request.param)
    return colcon(tmp_path) if request.param == "colcon" else pip(tmp_path, f"--{request.param.removeprefix('pip-')}")


def test_all_data_files_are_installed(installed: Installed) -> None:
    share = installed.prefix / "share"
    assert (share / "ament_index/resource_index/packages/biodyn_ros").is_file()
    assert (share / "biodyn_ros/package.xml").read_bytes() == (ROOT / "package.xml").read_bytes()
    # `ros2 launch` refuses a launch file that it finds twice.
    launched = {path.name for path in (ROOT / "config/launch").iterdir() if path.suffix == ".py"}
    assert sorted(share.rglob("*.launch.py")) == sorted(share / "biodyn_ros/launch" / name for name in launched)
    for kind in ("yaml", "xml", "json"):
        configured = {path.relative_to(ROOT / "config") for path in (ROOT / "config").rglob(f"*.{kind}")}
        there = share.rglob(f"config/**/*.{kind}")
        assert configured == {path.relative_to(share / "biodyn_ros/config") for path in there}
        assert configured


def test_an_installation_finds_its_files_from_any_directory(installed: Installed, tmp_path: Path) -> None:
    found = installed.run(f"{shlex.quote(sys.executable)} -c {shlex.quote(FIND_ALL)}", tmp_path).splitlines()
    workspace = installed.prefix.parents[1] if installed.setup.startswith(".") else installed.prefix
    assert all(Path(line).is_relative_to(workspace) for line in found), found
    names = [Path(line).name for line in found]
    assert sorted(names[2:]) == sorted(path.name for path in (ROOT / "config").rglob("*.yaml"))


@pytest.mark.parametrize("script", ["biodyn", "biodyn_live"])
def test_executables_are_in_the_directory_of_ros2_run(installed: Installed, script: str, tmp_path: Path) -> None:
    executable = installed.scripts / script
    assert os.access(executable, os.X_OK)
    first = executable.read_text(encoding="utf-8").splitlines()[0]
    assert first == f"#!{sys.executable}"


def test_the_command_starts_where_it_is_installed(installed: Installed, tmp_path: Path) -> None:
    assert "usage" in installed.run(f"{shlex.quote(str(installed.scripts / 'biodyn'))} --help", tmp_path).lower()


def test_a_symlinked_build_links_to_the_source(symlinked: Installed, tmp_path: Path) -> None:
    tree = symlinked.prefix.parents[1] / "src" / "biodyn"
    launch = symlinked.prefix / "share/biodyn_ros/launch/biodyn.launch.py"
    assert launch.resolve() == tree / "config/launch/biodyn.launch.py"
    script = "import biodyn_ros.base.resources as r; print(r.__file__)"
    module = symlinked.run(f"{shlex.quote(sys.executable)} -c {shlex.quote(script)}", tmp_path).strip()
    assert Path(module).resolve() == tree / "biodyn_ros/base/resources.py"


def test_the_manifest_names_only_keys_that_resolve() -> None:
    manifest = ET.parse(ROOT / "package.xml").getroot()
    assert (manifest.tag, manifest.get("format")) == ("package", "3")
    assert manifest.findtext("name") == "biodyn_ros"
    assert manifest.findtext("license") == "Apache-2.0"
    assert manifest.findtext("export/build_type") == "ament_python"
    assert re.fullmatch(r"\d+\.\d+\.\d+", manifest.findtext("version", ""))
    depends = [child.text for child in manifest if child.tag.endswith("depend")]
    assert len(depends) == len(set(depends))
    rosdep = yaml.safe_load((ROOT / "test/data/rosdep_noble.yaml").read_text(encoding="utf-8"))
    resolved = {*rosdep["python"]["keys"], *chain.from_iterable(rosdep["jazzy"]["packages"].values())}
    assert set(depends) == resolved
    assert not resolved & set(rosdep["python"]["not_on_noble"])


def test_the_code_of_the_live_node_imports_no_ros_package_that_the_manifest_does_not_name() -> None:
    depends = {child.text for child in ET.parse(ROOT / "package.xml").getroot() if child.tag.endswith("depend")}
    imported = {
        (node.module or "").split(".")[0]
        for path in (ROOT / "biodyn_ros").rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.ImportFrom) and not node.level
    }
    # These two come with rclpy and the messages, which depend on them.
    ros = {name for name in imported if name == "rclpy" or name.endswith(("_msgs", "_srvs", "_interfaces"))}
    assert ros - {"builtin_interfaces", "rcl_interfaces"} <= depends


def test_manifest_code_and_changelog_have_one_version() -> None:
    assert ET.parse(ROOT / "package.xml").findtext("version") == biodyn_ros.__version__
    newest = re.search(r"^## (\S+)", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert newest is not None
    assert newest[1] == biodyn_ros.__version__


def test_entry_points_name_functions_that_exist(tmp_path: Path) -> None:
    tree = copy_of_the_tree(tmp_path)
    run([sys.executable, "setup.py", "--quiet", "egg_info"], tree)
    parser = ConfigParser()
    parser.read(tree / "biodyn_ros.egg-info" / "entry_points.txt")
    scripts = dict(parser["console_scripts"])
    assert set(scripts) == {"biodyn", "biodyn_live"}
    for target in scripts.values():
        module, function = target.split(":")
        source = ast.parse((tree / Path(*module.split("."))).with_suffix(".py").read_text(encoding="utf-8"))
        assert function in {node.name for node in source.body if isinstance(node, ast.FunctionDef)}, target


class Stub:
    """An action or a substitution of the launch file; LaunchConfiguration reads from a dict."""

    def __init__(self, *places: object, **words: object) -> None:
        self.places, self.words = places, words

    def perform(self, context: dict[str, str]) -> str:
        """The argument as given."""
        return context[str(self.places[0])]


Loader = Callable[[str], dict[str, Callable[..., list[Stub]]]]


@pytest.fixture
def load(monkeypatch: pytest.MonkeyPatch) -> Loader:
    """Gives the definitions of a launch file, over stand-ins for ROS's launch, which has no wheel."""
    return lambda name: loaded(ROOT / "config/launch" / name, monkeypatch)


@pytest.fixture
def launch(load: Loader) -> dict[str, Callable[..., list[Stub]]]:
    """The definitions of the launch file of the live node."""
    return load("biodyn.launch.py")


def loaded(path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Callable[..., list[Stub]]]:
    """The definitions of a launch file, with every import of it replaced."""
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ImportFrom) and node.module is not None:
            assert node.module.split(".")[0] in {"launch", "launch_ros"}
            names = SimpleNamespace(**{alias.name: type(alias.name, (Stub,), {}) for alias in node.names})
            monkeypatch.setitem(sys.modules, node.module, names)
    return runpy.run_path(str(path))


def test_the_launch_file_starts_our_node_with_given_arguments(launch: dict[str, Callable[..., list[Stub]]]) -> None:
    nothing = dict.fromkeys([*launch["TEXTS"], *launch["VALUES"]], "")
    (node,) = launch["live_node"]({**nothing, "subject_file": "1", "yaw_deg": "90.0"})
    words = {name: word for name, word in node.words.items() if isinstance(word, str)}
    assert words == {"package": "biodyn_ros", "executable": "biodyn_live", "name": "biodyn", "output": "screen"}
    params_file, given = node.words["parameters"]
    assert params_file.places == ("params_file",)
    assert set(given) == {"subject_file", "yaw_deg"}
    assert given["yaw_deg"] == "90.0"
    # A name that looks like a number must reach the node as text.
    assert (given["subject_file"].places, given["subject_file"].words) == (("1",), {"value_type": str})


def test_the_launch_arguments_are_parameters_of_the_node(launch: dict[str, Callable[..., list[Stub]]]) -> None:
    (entities,) = launch["generate_launch_description"]().places
    arguments = {entity.places[0] for entity in entities if type(entity).__name__ == "DeclareLaunchArgument"}
    assert arguments == {"params_file", "namespace", *launch["TEXTS"], *launch["VALUES"]}
    arguments_by_name = {**launch["TEXTS"], **launch["VALUES"]}
    assert arguments_by_name.pop("use_sim_time")
    assert arguments_by_name == {name: declared()[name] for name in arguments_by_name}


def declared() -> dict[str, str]:
    """The parameters that the live node declares, each as it is described."""
    from biodyn_ros.node.params import description
    from biodyn_ros.node.settings import SETTINGS

    return {item.name: description(item) for kind in SETTINGS for item in dataclasses.fields(kind)}


def test_the_bag_s_launch_file_plays_it_to_the_node(load: Loader) -> None:
    launch = load("replay_bag.launch.py")
    (entities,) = launch["generate_launch_description"]().places
    arguments = {e.places[0]: e.words for e in entities if type(e).__name__ == "DeclareLaunchArgument"}
    assert set(arguments) == set(launch["ARGUMENTS"])
    assert launch["ARGUMENTS"]["subject_file"][1] == declared()["subject_file"]
    assert [name for name, words in arguments.items() if "default_value" not in words] == ["bag"]
    given = {name: words.get("default_value", "drive.mcap") for name, words in arguments.items()}
    for loop, more in (("false", []), ("True", ["--loop"])):
        player, node = launch["player_and_node"]({**given, "loop": loop})
        executable, *words = player.words["cmd"]
        assert executable.words == {"package": "biodyn_ros", "executable": "biodyn"}
        assert words == ["play", "drive.mcap", "--rate", "1.0", *more]
        assert parser(["play"]).parse_args(words).bag == "drive.mcap"
        assert (node.words["package"], node.words["executable"]) == ("biodyn_ros", "biodyn_live")


@pytest.mark.parametrize(
    "name",
    [
        "biodyn.launch.py",
        "replay_bag.launch.py",
    ],
)
def test_every_parameter_that_a_launch_file_gives_is_declared(load: Loader, name: str) -> None:
    launch = load(name)
    made = "live_node" if "live_node" in launch else "player_and_node"
    configured = dict.fromkeys([key for table in tables(launch) for key in table], "1")
    (node,) = (e for e in launch[made](configured) if type(e).__name__ == "LifecycleNode")
    given = node.words["parameters"][-1]
    assert given
    assert set(given) - {"use_sim_time"} <= set(declared())


def tables(launch: dict[str, Any]) -> list[dict[str, Any]]:
    """The tables of arguments of a launch file."""
    return [launch[name] for name in ("TEXTS", "VALUES", "ARGUMENTS") if name in launch]


def test_launch_files_start_installed_executables(tmp_path: Path) -> None:
    scripts = set(re.findall(r'^\s+"(\w+) = biodyn_ros', (ROOT / "setup.py").read_text(encoding="utf-8"), re.MULTILINE))
    for path in (ROOT / "config/launch").glob("*.py"):
        text = path.read_text(encoding="utf-8")
        started = set(re.findall(r'executable="(\w+)"', text))
        assert started
        assert started <= scripts


@pytest.fixture
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An installation found through AMENT_PREFIX_PATH alone, the module being in no tree and below no prefix."""
    share = tmp_path / "prefix/share/biodyn_ros"
    (share / "config/subjects").mkdir(parents=True)
    (share / "bags").mkdir()
    for name in ("package.xml", "config/limits.yaml", "config/subjects/tall.yaml", "bags/short.mcap"):
        (share / name).touch()
    monkeypatch.setattr(resources, "__file__", str(tmp_path / "code/biodyn_ros/base/resources.py"))
    monkeypatch.setattr(sys, "prefix", str(tmp_path / "nothing"))
    monkeypatch.setenv("AMENT_PREFIX_PATH", os.pathsep.join(["", str(tmp_path / "other"), str(tmp_path / "prefix")]))
    monkeypatch.chdir(tmp_path)
    return share


def test_files_are_found_through_the_ament_prefix_path(elsewhere: Path) -> None:
    assert resources.config_file("limits.yaml") == elsewhere / "config/limits.yaml"
    assert resources.bag_file("short.mcap") == elsewhere / "bags/short.mcap"
    assert resources.subject_names() == ["tall"]
    assert resources.subject_file("tall") == elsewhere / "config/subjects/tall.yaml"


def test_files_are_found_below_the_prefix_of_the_interpreter(elsewhere: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("AMENT_PREFIX_PATH")
    monkeypatch.setattr(sys, "prefix", str(elsewhere.parents[1]))
    assert resources.config_file("limits.yaml") == elsewhere / "config/limits.yaml"


def test_a_subject_by_path_goes_before_a_bundled_one(elsewhere: Path) -> None:
    Path("tall").touch()
    assert resources.subject_file("tall") == Path("tall")


@pytest.mark.parametrize(
    ("find", "name", "message"),
    [
        (resources.subject_file, "short", "no subject file short; bundled: tall; give others by path"),
        (resources.subject_file, "no/tall", r"no subject file no/tall; did you mean tall\? bundled: tall"),
        (resources.config_file, "live.yaml", "no live.yaml in .*config; there is limits.yaml, subjects"),
        (resources.bag_file, "long.mcap", "no long.mcap in .*bags; there is short.mcap"),
        (resources.package_directory, "nowhere", "the installation is incomplete: .*nowhere is missing"),
    ],
)
def test_a_missing_file_is_reported_with_the_existing_ones(
    elsewhere: Path, find: Callable[[str], Path], name: str, message: str
) -> None:
    with pytest.raises(InputError, match=rf"\A{message}"):
        find(name)


def test_missing_data_files_are_reported(elsewhere: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("AMENT_PREFIX_PATH")
    with pytest.raises(InputError, match=r"\Anone of .* holds the files of biodyn; install it again\Z"):
        resources.subject_names()


def test_every_file_in_the_order_of_tests_exists() -> None:
    assert [name for name in SLOW if not (ROOT / "test" / f"{name}.py").is_file()] == []
