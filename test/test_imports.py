"""The rules of who imports whom, checked on the source."""

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import ordering
import pytest

ROOT = Path(__file__).resolve().parents[1]

PACKAGES = (
    "base",
    "effects",
    "kernels",
    "signals",
    "body",
    "population",
    "conditioning",
    "exposure",
    "recording",
    "sessions",
    "pipeline",
    "validation",
    "identification",
    "tracing",
    "sensor_pairs",
)
"""The packages of biodyn_core in the order of their imports: a module imports from its own package and those before."""

CORE_NEEDS = {"numpy", "scipy", "yaml"}
COMPILED = "biodyn_core.kernels.compiling"

NEEDS_ROS = {
    "commands.cli",
    "commands.demo",
    "commands.live",
    "commands.page",
    "commands.play",
    "dashboard.feed",
    "dashboard.site",
    "demo",
    "node.callbacks",
    "node.live",
    "node.parameters_yaml",
    "node.params",
    "node.publications",
    "node.subscriptions",
    "play.player",
}
"""The modules of biodyn_ros that import ROS; all others work without it."""

ROS = {
    "rclpy",
    "ament_index_python",
    "builtin_interfaces",
    "diagnostic_msgs",
    "geometry_msgs",
    "trajectory_msgs",
    "launch",
    "launch_ros",
    "lifecycle_msgs",
    "rcl_interfaces",
    "rosgraph_msgs",
    "sensor_msgs",
    "std_msgs",
    "std_srvs",
}


def modules(root: Path, package: str) -> dict[str, ast.Module]:
    """Every module of a package by its dotted name."""
    found = {}
    for path in sorted((root / package).rglob("*.py")):
        parts = path.relative_to(root).with_suffix("").parts
        name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        found[name] = ast.parse(path.read_text(encoding="utf-8"), str(path))
    return found


def imported(name: str, tree: ast.Module, known: dict[str, ast.Module], is_package: bool) -> Iterator[str]:
    """The dotted names that a module imports anywhere, also inside functions."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            here = name.split(".")
            upward = here[: len(here) - node.level + is_package] if node.level else []
            origin = ".".join([*upward, *([node.module] if node.module else [])])
            # `from package import module` names the module, `from module import thing` does not.
            for alias in node.names:
                inner = f"{origin}.{alias.name}"
                yield inner if inner in known else origin


def graph(root: Path, package: str) -> dict[str, set[str]]:
    """The imports of each module of a package."""
    known = modules(root, package)
    return {
        name: set(imported(name, tree, known, (root / Path(*name.split("."))).is_dir())) - {name}
        for name, tree in known.items()
    }


def place(module: str) -> int | None:
    """The place of a module's package in the order; None where the order does not have it."""
    package = module.split(".")[1]
    return PACKAGES.index(package) if package in PACKAGES else None


def core_faults(root: Path) -> list[str]:
    """Violations of a rule in `biodyn_core`, one line each."""
    imports = graph(root, "biodyn_core")
    faults = []
    for name, targets in imports.items():
        inner = {target for target in targets if target.split(".")[0] == "biodyn_core"}
        for target in sorted(targets - inner):
            top = target.split(".")[0]
            allowed = top in CORE_NEEDS or top in sys.stdlib_module_names or (top == "numba" and name == COMPILED)
            if not allowed:
                faults.append(f"{name} imports {target}")
        if name == "biodyn_core":
            # Every import of the core runs it, so it must cost and need nothing.
            faults += [f"biodyn_core/__init__.py imports {target}" for target in sorted(inner)]
        elif place(name) is None:
            faults.append(f"{name} is in no package of the order: see PACKAGES in {Path(__file__).name}")
        else:
            faults += [f"{name} imports {target}" for target in sorted(inner) if not reaches_down(name, target)]
    try:
        TopologicalSorter(imports).prepare()
    except CycleError as error:
        faults.append("circle: " + " -> ".join(error.args[1]))
    return faults


def reaches_down(name: str, target: str) -> bool:
    """Whether the target is in the same or an earlier package."""
    above, below = place(name), None if target == "biodyn_core" else place(target)
    return above is not None and below is not None and below <= above


def ros_faults(root: Path, needs_ros: set[str] = NEEDS_ROS) -> list[str]:
    """Imports of ROS, direct or indirect, in modules that must run without it."""
    imports = graph(root, "biodyn_ros")
    faults = []
    for start in imports:
        if start.removeprefix("biodyn_ros.") in needs_ros:
            continue
        seen, waiting = {start}, [start]
        while waiting:
            name = waiting.pop()
            faults += [f"{start}: {name} imports {target}" for target in imports[name] if target.split(".")[0] in ROS]
            new = imports[name] & imports.keys() - seen
            seen |= new
            waiting += new
    return faults


def packages(root: Path) -> dict[str, set[str]]:
    """Imports between the packages and top-level modules of biodyn_ros."""
    found: dict[str, set[str]] = {}
    for name, targets in graph(root, "biodyn_ros").items():
        package = name.partition(".")[2].partition(".")[0]
        inner = {target.split(".")[1] for target in targets if target.startswith("biodyn_ros.")}
        found.setdefault(package, set()).update(inner - {package})
    return found


def test_the_packages_of_biodyn_ros_have_no_import_cycle() -> None:
    TopologicalSorter(packages(ROOT)).prepare()


def test_a_cycle_of_packages_is_found_without_a_cycle_of_modules(tmp_path: Path) -> None:
    for path, source in {
        "fit/a": "import biodyn_ros.work.b",
        "work/b": "",
        "work/c": "import biodyn_ros.fit.a",
    }.items():
        file = tmp_path / "biodyn_ros" / f"{path}.py"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(source)
    TopologicalSorter(graph(tmp_path, "biodyn_ros")).prepare()
    with pytest.raises(CycleError):
        TopologicalSorter(packages(tmp_path)).prepare()


def test_core_imports_point_downward() -> None:
    assert core_faults(ROOT) == []


def test_ros_free_modules_never_reach_ros() -> None:
    assert ros_faults(ROOT) == []
    reaching = {line.partition(":")[0].removeprefix("biodyn_ros.") for line in ros_faults(ROOT, set())}
    assert reaching == NEEDS_ROS


@cache
def loaded_in_turn() -> tuple[list[str], list[str]]:
    """The modules after a process has loaded the model, and after it has loaded the live node too."""
    code = "import sys, {}; print(*sys.modules);" * 2
    words = [sys.executable, "-c", code.format("biodyn_core.body.model", "biodyn_ros.node.live")]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True)
    model, live = done.stdout.splitlines()
    return model.split(), live.split()


def test_the_live_node_reaches_neither_identification_nor_tracing() -> None:
    _, live = loaded_in_turn()
    refused = ("biodyn_core.identification", "biodyn_core.tracing", "biodyn_core.signals.response")
    assert "biodyn_ros.node.live" in live
    assert [name for name in live if name.startswith(refused)] == []


def test_a_model_loads_without_the_slow_parts_of_scipy() -> None:
    model, _ = loaded_in_turn()
    assert "biodyn_core.body.model" in model
    assert not {"scipy.signal", "scipy.interpolate"} & set(model)


def test_a_live_node_loads_scipy_before_the_first_sample() -> None:
    """Parts of scipy load at their first use, which would delay samples by half a second."""
    _, live = loaded_in_turn()
    parts = ("fft", "interpolate", "linalg", "ndimage", "optimize", "signal", "special")
    assert {f"scipy.{part}" for part in parts} <= set(live)


@pytest.mark.parametrize(
    ("path", "source", "fault"),
    [
        ("base/errors.py", "import rclpy", "biodyn_core.base.errors imports rclpy"),
        ("base/errors.py", "import biodyn_ros.bag", "biodyn_core.base.errors imports biodyn_ros.bag"),
        (
            "pipeline/late.py",
            "def f():\n    import matplotlib.pyplot",
            "biodyn_core.pipeline.late imports matplotlib.pyplot",
        ),
        ("body/model.py", "import numba", "biodyn_core.body.model imports numba"),
        (
            "base/segments.py",
            "from biodyn_core.body import model",
            "biodyn_core.base.segments imports biodyn_core.body",
        ),
        ("kernels/chain.py", "from ..body.subject import S", "biodyn_core.kernels.chain imports biodyn_core.body"),
        ("effects/joint.py", "from ..body.model import Chain", "biodyn_core.effects.joint imports biodyn_core.body"),
        ("effects/__init__.py", "from . import seat", "circle: biodyn_core.effects"),
        ("surprise.py", "", "biodyn_core.surprise is in no package of the order"),
        ("surprise/__init__.py", "", "biodyn_core.surprise is in no package of the order"),
        ("__init__.py", "from biodyn_core.body import model", "biodyn_core/__init__.py imports biodyn_core.body.model"),
    ],
)
def test_a_broken_rule_is_reported(tmp_path: Path, path: str, source: str, fault: str) -> None:
    core = tmp_path / "biodyn_core"
    for package in ("", "base", "body", "effects", "kernels", "pipeline", "surprise"):
        (core / package).mkdir(parents=True, exist_ok=True)
        if package != "surprise":
            (core / package / "__init__.py").touch()
    (core / "effects/seat.py").write_text("import biodyn_core.effects")
    for name in ("model", "subject"):
        (core / f"body/{name}.py").touch()
    assert core_faults(tmp_path) == []
    (core / path).write_text(source)
    assert len([line for line in core_faults(tmp_path) if line.startswith(fault)]) == 1


def test_the_order_names_every_package_once() -> None:
    packages = {path.parent.name for path in (ROOT / "biodyn_core").glob("*/__init__.py")}
    assert sorted(PACKAGES) == sorted(packages)
    assert [path.name for path in (ROOT / "biodyn_core").glob("*.py")] == ["__init__.py"]


def test_the_tables_of_contributing_list_every_package() -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").split("## Where to change what")[0]
    assert tuple(re.findall(r"^\| \[(\w+)\]\(biodyn_core/\1\) \|", text, re.MULTILINE)) == PACKAGES
    folders = {path.name for path in (ROOT / "biodyn_ros").iterdir() if path.is_dir() and path.name != "__pycache__"}
    rows = "".join(re.findall(r"^\| \[.*", text.split("biodyn_ros has packages")[1], re.MULTILINE))
    assert set(re.findall(r"\]\(biodyn_ros/(\w+)\)", rows)) == folders


def test_numba_is_allowed_in_the_kernels(tmp_path: Path) -> None:
    (tmp_path / "biodyn_core/kernels").mkdir(parents=True)
    (tmp_path / "biodyn_core/__init__.py").touch()
    (tmp_path / "biodyn_core/kernels/__init__.py").touch()
    (tmp_path / "biodyn_core/kernels/compiling.py").write_text("import numba")
    assert core_faults(tmp_path) == []


def test_an_indirect_import_of_ros_is_reported(tmp_path: Path) -> None:
    (tmp_path / "biodyn_ros/node").mkdir(parents=True)
    (tmp_path / "biodyn_ros/bag_reader.py").write_text("from biodyn_ros.node.params import Table")
    (tmp_path / "biodyn_ros/node/params.py").write_text("from rcl_interfaces.msg import ParameterDescriptor")
    assert ros_faults(tmp_path) == ["biodyn_ros.bag_reader: biodyn_ros.node.params imports rcl_interfaces.msg"]


def test_the_order_of_tests_names_files_that_exist() -> None:
    names = {*ordering.SLOW, *ordering.SHARED}
    assert [name for name in sorted(names) if not (Path(__file__).parent / f"{name}.py").is_file()] == []
