"""Installs biodyn with pip and, as an ament_python package, with colcon."""

from pathlib import Path
from xml.etree import ElementTree as ET

from setuptools import find_packages, setup

NAME = "biodyn_ros"
SHARE = Path("share") / NAME

EXTRAS = {
    # ROS 2 Jazzy as wheels. On a robot leave this one out: there ROS comes from apt.
    "ros": [
        "ros-jazzy-ament-index-python",
        "ros-jazzy-common-interfaces",
        "ros-jazzy-diagnostic-msgs",
        "ros-jazzy-geometry-msgs",
        "ros-jazzy-lifecycle-msgs",
        "ros-jazzy-rclpy",
        # rclpy does not ask for a middleware, and without one no node starts.
        "ros-jazzy-rmw-fastrtps-cpp",
        "ros-jazzy-rosgraph-msgs",
        "ros-jazzy-std-srvs",
    ],
    "fast": ["numba>=0.59"],
    "bags": ["mcap>=1.1", "rosbags>=0.10", "lz4>=4.0", "zstandard>=0.20"],
    "page": ["aiohttp>=3.9"],
    "reports": ["jinja2>=3.0", "matplotlib>=3.6"],
    "cluster": ["dask[distributed]>=2024.1"],
    # The version whose scripts for bash, zsh and fish were tried.
    "completion": ["shtab>=1.13"],
}
EXTRAS["all"] = sorted(requirement for extra in EXTRAS.values() for requirement in extra)
EXTRAS["fuzz"] = ["atheris>=3.0; python_version >= '3.11'"]
EXTRAS["dev"] = [
    "colcon-common-extensions",
    "colcon-ros",
    "hypothesis>=6.80",
    "mypy>=1.8",
    # Drives the Chromium that is there: a browser itself is on no package index for Python.
    "playwright>=1.40",
    "pytest>=7.4",
    "pytest-timeout>=2.1",
    "pytest-xdist>=3.5",
    "ruff>=0.6",
    # colcon builds with `setup.py install` and `setup.py develop --editable`: version 80 took the second away, and a
    # symlinked build falls back to copies without a word. Before 70.1 a wheel needs one package more.
    "setuptools>=70.1,<80",
    "types-PyYAML",
]


def files_below(directory: str, *patterns: str) -> list[Path]:
    """The files below a directory that match a pattern, in a fixed order; none where there is no such directory."""
    found = {path for pattern in patterns for path in Path(directory).rglob(pattern)}
    return sorted(path for path in found if path.is_file() and "__pycache__" not in path.parts)


def data_files() -> list[tuple[str, list[str]]]:
    """The files installed beside the code: the ament marker, the manifest, launch file, configuration and bags."""
    targets: dict[str, list[str]] = {
        "share/ament_index/resource_index/packages": [f"resource/{NAME}"],
        str(SHARE): ["package.xml"],
    }
    for path in [*files_below("config", "*"), *files_below("bags", "*.mcap", "*.yaml", "*.md")]:
        # `ros2 launch` looks in share/<package>, and refuses a launch file that it finds twice.
        target = SHARE / "launch" if path.parent.name == "launch" else SHARE / path.parent
        targets.setdefault(str(target), []).append(str(path))
    return list(targets.items())


def version() -> str:
    """The version that package.xml has."""
    found = ET.parse("package.xml").findtext("version")
    if found is None:
        raise SystemExit("setup.py: package.xml has no <version>")
    return found


setup(
    name=NAME,
    version=version(),
    description="Whole-body vibration of a seated occupant from six IMUs: prediction, exposure, identification, ROS 2",
    author="biodyn developers",
    author_email="maintainers@biodyn.example",
    license="Apache-2.0",
    python_requires=">=3.10,<3.14",
    packages=find_packages(include=["biodyn_core", "biodyn_core.*", "biodyn_ros", "biodyn_ros.*"]),
    package_data={
        "biodyn_core": [
            "tracing/learned.json",
            "tracing/louder.json",
            "population/population.json",
            "population/references.yaml",
        ],
        "biodyn_ros": ["page/*", "templates/*"],
    },
    data_files=data_files(),
    # SciPy 1.11 and numpy 1.26 are those of Ubuntu 24.04.
    install_requires=["numpy>=1.26", "scipy>=1.11", "PyYAML>=6.0"],
    extras_require=EXTRAS,
    entry_points={
        "console_scripts": [
            "biodyn = biodyn_ros.commands.cli:main",
            "biodyn_live = biodyn_ros.node.live:main",
        ],
    },
    zip_safe=False,
)
