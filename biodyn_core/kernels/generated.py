"""The integrator with effects: the source of `chain.py` with their functions inserted, compiled and cached.

numba caches no functions that are passed as arguments, but it caches files for the next process. The files lie in the
user's folder under the hash of their content, and are used only while the content is unchanged.
"""

from __future__ import annotations

import functools
import hashlib
import importlib.util
import inspect
import os
import re
import sys
import textwrap
import types
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

from biodyn_core.base.segments import N_SEGMENTS
from biodyn_core.kernels import chain
from biodyn_core.kernels.compiling import CACHE

Role = Literal["force of a joint", "limit of a joint", "force on a segment"]


class Piece(NamedTuple):
    """The law of an effect at one joint or segment, and its inputs beyond the motion.

    drives are columns of the integrator's drive; states and constants of the law are counts; past is the number of
    stored steps of the joint's stretch, 0 without delay. In p, the joint or segment (0 to 5) comes before the constants
    of the law; of a force that is spread, its shares for the six segments, by which the motion is averaged too. A delay
    is between them: its number of steps, at least 1.
    """

    role: Role
    function: Callable[..., Any]
    states: int
    constants: int
    drives: tuple[int, ...] = ()
    past: int = 0
    spread: bool = False

    @property
    def all_states(self) -> int:
        """The number of states in q; each drive is one too, linear up to its next sample."""
        return len(self.drives) + self.states

    @property
    def leading(self) -> int:
        """Places in p before the constants of the law: where it acts, and the delay."""
        return (N_SEGMENTS if self.spread else 1) + bool(self.past)

    @property
    def memory(self) -> int:
        """Places in p after the constants: slopes of drives; delayed stretch, number of steps, and the ring."""
        return len(self.drives) + (2 + self.past if self.past else 0)


def integrator(pieces: Sequence[Piece]) -> Callable[..., None]:
    """`integrate_chain` with these pieces; their states are consecutive in q, their constants with memory in p.

    Where a piece acts is a number in p: one source text, which takes a second to compile, serves all sites.
    """
    return _integrator(tuple(pieces)) if pieces else chain.integrate_chain


@functools.lru_cache(maxsize=1024)
def _integrator(pieces: tuple[Piece, ...]) -> Callable[..., None]:
    """Generate and load once per process: a search needs the same integrator thousands of times."""
    return _load(_source(pieces))


def _source(pieces: Sequence[Piece]) -> str:
    """The source of `chain.py` with the pieces at its marks; limits follow all forces."""
    marks = {"functions": [_FUNCTIONS, *(_piece_source(piece.function, n) for n, piece in enumerate(pieces))]}
    state = place = 0
    limits: list[str] = []
    for number, piece in enumerate(pieces):
        for mark, lines in _lines(number, piece, state, place).items():
            last = mark == "joints" and piece.role == "limit of a joint"
            (limits if last else marks.setdefault(mark, [])).append(lines)
        state, place = state + piece.all_states, place + piece.leading + piece.constants + piece.memory
    marks.setdefault("joints", []).extend(limits)
    # With a literal count the compiler unrolls the loops over states, which saves a tenth of a step.
    marks.setdefault("states", []).append(f"states = {state}\n")
    text = re.sub(
        r"^( *)# effects: (\w+)\n",
        lambda found: textwrap.indent("".join(marks.get(found[2], [])), found[1]),
        inspect.getsource(chain),
        flags=re.MULTILINE,
    )
    return text.replace("import numpy as np\n", "import math\n\nimport numpy as np\n", 1)


def _lines(number: int, piece: Piece, state: int, place: int) -> dict[str, str]:
    """The lines of a piece by mark; its states begin at q[state], and what it has in p at p[place]."""
    drives = [f"q[{state + i}]" for i in range(len(piece.drives))]
    states = [f"q[{state + len(drives) + i}]" for i in range(piece.states)]
    first = place + piece.leading
    constants = [f"p[{first + i}]" for i in range(piece.constants)]
    slopes = [f"p[{first + piece.constants + i}]" for i in range(len(drives))]
    memory = first + piece.constants + len(drives)
    at, here = f"at_{number} = int(p[{place}])\n", f"if j == at_{number}:\n    "
    if piece.role == "limit of a joint":
        limited = f"_piece_{number}({', '.join(['force', 'rate', *constants])})"
        return {"before": at, "joints": f"{here}force = {limited}\n"}
    mark, total, motion = _TOTALS[piece.role]
    shares = range(place, place + N_SEGMENTS)
    averaged = [" + ".join(f"p[{share}] * {name}[{j}]" for j, share in enumerate(shares)) for name in "xv"]
    x, v = averaged if piece.spread else (motion.format(name, number) for name in "xv")
    delayed = [f"p[{memory}]"] if piece.past else []
    arguments = ", ".join([x, v, "seat", *delayed, *drives, *states, *constants])
    added = f"added_{number}"
    results = ", ".join([added, *(f"d{name}" for name in states)])
    lines = {
        "before": f"{results} = _piece_{number}({arguments})\n",
        mark: f"{total} += p[{place} + j] * {added}\n" if piece.spread else f"{here}{total} += {added}\n",
        "samples": "",
    }
    if not piece.spread:
        lines["before"] = at + lines["before"]
    if drives:
        drive_lines = ""
        for slope, q, column in zip(slopes, drives, piece.drives, strict=True):
            lines["samples"] += f"{slope} = (drive[n, {column}] - {q}) / (step_s * substeps)\nd1{q[1:]} = {slope}\n"
            drive_lines += f"d{q} = {slope}\n"
        lines["before"] = drive_lines + lines["before"]
    if piece.past:
        for name, ahead in (("middle", 0.5), ("end", 1.0)):
            lines[name] = f"p[{memory}] = _look_back(p, {memory + 1}, {piece.past}, p[{first - 1}] - {ahead})\n"
        lines["states"] = at
        lines["past"] = f"p[{memory + 1}] += 1.0\np[{memory + 2} + int(p[{memory + 1}]) % {piece.past}] = {x}\n"
    return lines


_TOTALS: Final = {
    "force of a joint": ("joints", "force", "_at_joint({}, at_{})"),
    "force on a segment": ("segments", "load", "{}[at_{}]"),
}
"""The mark in the integrator, the sum there, and the motion that a law gets."""

_FUNCTIONS: Final = '''@inlined
def _at_joint(x: Floats, at: int) -> float:
    """The motion of the upper segment of a joint relative to the lower one, the seat below the first."""
    return x[at] - x[at - 1] if at > 0 else x[0]


@compiled
def _look_back(p: Floats, at: int, length: int, steps: float) -> float:
    """The ring behind p[at], so many steps before the last of p[at] in all; straight between steps, 0 before them."""
    wanted = p[at] - steps
    if wanted <= 0.0:
        return 0.0
    first = int(wanted)
    earlier = p[at + 1 + first % length] if first > 0 else 0.0
    return earlier + (wanted - first) * (p[at + 1 + (first + 1) % length] - earlier)


'''


def _piece_source(function: Callable[..., Any], number: int) -> str:
    """The source of a function renamed `_piece_<number>` and compiled separately; LLVM inlines it."""
    source = textwrap.dedent(inspect.getsource(function))
    return "@compiled\n" + re.sub(rf"def {function.__name__}\(", f"def _piece_{number}(", source, count=1) + "\n\n"


@functools.cache
def _load(text: str) -> Callable[..., None]:
    """The integrator of a source text, from a file in the user's folder where there is one."""
    name = f"chain_{hashlib.sha256(text.encode()).hexdigest()[:32]}"
    module = types.ModuleType(f"biodyn_generated.{name}")
    if CACHE is None:
        exec(compile(text, name, "exec"), module.__dict__)  # noqa: S102 - generated here from our own source
    else:
        path = cached_file(Path(CACHE) / "generated" / f"{name}.py", text)
        spec = importlib.util.spec_from_file_location(module.__name__, path)
        if spec is None or spec.loader is None:
            raise ImportError(f"{path}: cannot be loaded")
        module = importlib.util.module_from_spec(spec)
        sys.modules[module.__name__] = module  # numba looks up the modules of its functions
        spec.loader.exec_module(module)
    found: Callable[..., None] = module.integrate_chain
    return found


def cached_file(path: Path, text: str) -> Path:
    """A file with exactly this text, not rewritten if it is there already: numba's cache depends on its date."""
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    if not (path.is_file() and path.read_text(encoding="utf-8") == text):
        part = path.with_name(f".{path.name}.{os.getpid()}.part")
        part.write_text(text, encoding="utf-8")
        part.replace(path)
    return path
