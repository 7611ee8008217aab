"""The policy allows the topics of the node and no others; no input is unpickled, and no shell gets a text."""

from __future__ import annotations

import ast
import re
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
from ros import ros_graph

ROOT = Path(__file__).resolve().parents[1]
POLICY = ROOT / "config" / "sros2" / "biodyn.policy.xml"
OURS = sorted(path for package in ("biodyn_core", "biodyn_ros") for path in (ROOT / package).rglob("*.py"))


def allowed(kind: str, access: str) -> set[str]:
    """The names that the policy allows, absolute."""
    (profile,) = ET.parse(POLICY).getroot().iter("profile")
    assert (profile.get("node"), profile.get("ns")) == ("biodyn", "/")
    return {item.text for group in profile.iter(f"{kind}s") if group.get(access) == "ALLOW" for item in group}


def test_the_policy_allows_the_topics_of_the_node_and_no_others() -> None:
    with ros_graph() as graph:
        tester = graph.node()
        graph.active()
        entities = {
            ("topic", "publish"): tester.get_publisher_names_and_types_by_node,
            ("topic", "subscribe"): tester.get_subscriber_names_and_types_by_node,
            ("service", "reply"): tester.get_service_names_and_types_by_node,
        }
        for (kind, access), names_of in entities.items():
            # A simulated clock is subscribed to on request.
            asked = allowed(kind, access) - {"/clock"}

            def used(names_of=names_of) -> set[str]:
                return {name for name, _ in names_of("biodyn", "/")}

            graph.wait(lambda used=used, asked=asked: used() == asked, f"{access} of what the policy allows")
    assert "/clock" in allowed("topic", "subscribe")


READS_CODE = {"pickle", "marshal", "shelve", "dill", "cloudpickle", "joblib"}
OWN_WORKERS = ROOT / "biodyn_ros" / "work" / "executor_map.py"
"""It gives a value to its own worker processes by a file in a private temporary folder, as their pipes give tasks."""


@pytest.mark.parametrize("path", OURS, ids=lambda path: str(path.relative_to(ROOT)))
def test_nothing_is_unpickled_evaluated_or_given_to_a_shell(path: Path) -> None:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, (ast.Import, ast.ImportFrom)):
            names = [alias.name for alias in node.names] + [getattr(node, "module", None) or ""]
            found = {name.split(".")[0] for name in names} & READS_CODE
            assert found <= ({"pickle"} if path == OWN_WORKERS else set()), ast.unparse(node)
        if isinstance(node, ast.Call):
            called = ast.unparse(node.func)
            # Without a place for files, the integrator is run from the text that was made of its own source.
            ours = called == "exec" and path.name == "generated.py"
            assert ours or called not in ("eval", "exec", "os.system", "os.popen", "__import__"), ast.unparse(node)
            given = {keyword.arg: ast.unparse(keyword.value) for keyword in node.keywords}
            assert given.get("shell", "False") == "False", ast.unparse(node)
            assert given.get("allow_pickle", "False") == "False", ast.unparse(node)
            if called.startswith("yaml.") and "load" in called:
                loader = given.get("Loader", ast.unparse(node.args[1]) if len(node.args) > 1 else "")
                assert called == "yaml.safe_load" or issubclass_of_safe(loader, tree), ast.unparse(node)


def issubclass_of_safe(name: str, tree: ast.Module) -> bool:
    """Whether a loader is one of this module that inherits from PyYAML's SafeLoader, in Python or compiled."""
    found = [node for node in ast.walk(tree) if isinstance(node, ast.ClassDef) and node.name == name]
    imported = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.module == "yaml"]
    named = [(alias.asname or alias.name, alias.name) for node in imported for alias in node.names]
    sources = {source for base, source in named if base == "SafeLoader"}
    bases = [ast.unparse(base) for base in found[0].bases] if found else []
    return bases == ["yaml.SafeLoader"] or (bases == ["SafeLoader"] and sources == {"SafeLoader", "CSafeLoader"})


def test_the_page_of_security_names_every_open_interface() -> None:
    text = " ".join((ROOT / "docs" / "security_and_faults.md").read_text(encoding="utf-8").split())
    for expected in (
        "config/sros2/biodyn.policy.xml",
        "ROS_LOCALHOST_ONLY",
        "ROS_AUTOMATIC_DISCOVERY_RANGE",
        "trusted network",
    ):
        assert expected in text, expected
    assert re.search(r"tcp://.*trusted", text)
