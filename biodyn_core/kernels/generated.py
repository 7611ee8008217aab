"""The integrator with effects in it: the source of `chain.py` with their functions written in, compiled and cached.

A compiled function that is passed into another is never found in numba's cache by a second process; a file is. Files
lie in the user's own folder under a name made of their content, and are used only while they hold just that.
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

ANYWHERE: Final = -1
"""Of a piece whose place is told by its constants alone."""

Role = Literal["force of a joint", "limit of a joint", "force on a segment"]


class Piece(NamedTuple):
    """One function of an effect at one joint or segment (0 to 5), and what it takes besides its motion.

    drives are columns of the integrator's drive; states and constants are counts; past is how many steps of the joint's
    stretch it keeps, 0 where it does not look back. Its first six constants are what each joint or segment gets of its
    force, one where it sits and zero elsewhere; if it looks back, the next is how many steps, 1 at least.
    """

    role: Role
    function: Callable[..., Any]
    at: int
    states: int
    constants: int
    drives: tuple[int, ...] = ()
    past: int = 0

    @property
    def all_states(self) -> int:
        """States in q: a drive is one too, that runs straight to its next sample."""
        return len(self.drives) + self.states

    @property
    def memory(self) -> int:
        """Places in p behind the constants: slopes of drives; what is looked back at, steps so far, and the ring."""
        return len(self.drives) + (2 + self.past if self.past else 0)


def integrator(pieces: Sequence[Piece]) -> Callable[..., None]:
    """`integrate_chain` with these pieces; their states, and constants with memory, follow each other in q and p.

    Where a single piece sits is part of the text: as numbers in p the other joints wait for it, at twice the time.
    Where there are several it is numbers: a search for a second effect would compile a text for every pair of sites.
    """
    if len(pieces) > 1:
        pieces = [piece._replace(at=ANYWHERE) for piece in pieces]
    return _integrator(tuple(pieces)) if pieces else chain.integrate_chain


@functools.lru_cache(maxsize=1024)
def _integrator(pieces: tuple[Piece, ...]) -> Callable[..., None]:
    """Written and loaded once a process: a search asks for the same one thousands of times."""
    return _load(_source(pieces))


def _source(pieces: Sequence[Piece]) -> str:
    """The text of `chain.py` with the pieces at its marks; limits come behind all forces."""
    marks = {"functions": [_LOOK_BACK, *(_renamed(piece.function, n) for n, piece in enumerate(pieces))]}
    state = place = 0
    limits: list[str] = []
    for number, piece in enumerate(pieces):
        for mark, lines in _lines(number, piece, state, place).items():
            last = mark == "joints" and piece.role == "limit of a joint"
            (limits if last else marks.setdefault(mark, [])).append(lines)
        state, place = state + piece.all_states, place + piece.constants + piece.memory
    marks.setdefault("joints", []).extend(limits)
    # Loops over so many that are known as text, not by a number, are unrolled: some tenth of a step
    # with states (bending took 1.47 times the bare one, and takes 1.29).
    marks["states"] = [f"states = {state}\n"]
    text = re.sub(
        r"^( *)# effects: (\w+)\n",
        lambda found: textwrap.indent("".join(marks.get(found[2], [])), found[1]),
        inspect.getsource(chain),
        flags=re.MULTILINE,
    )
    return text.replace("import numpy as np\n", "import math\n\nimport numpy as np\n", 1)


def _lines(number: int, piece: Piece, state: int, place: int) -> dict[str, str]:
    """What a piece writes at which mark, its states beginning at q[state] and its constants at p[place]."""
    drives = [f"q[{state + i}]" for i in range(len(piece.drives))]
    states = [f"q[{state + len(drives) + i}]" for i in range(piece.states)]
    constants = [f"p[{place + i}]" for i in range(N_SEGMENTS, piece.constants)]
    slopes = [f"p[{place + piece.constants + i}]" for i in range(len(drives))]
    seen = place + piece.constants + len(drives)
    if piece.role == "limit of a joint":
        limited = f"_piece_{number}({', '.join(['force', *constants])})"
        here = f"j == {piece.at}" if piece.at != ANYWHERE else f"p[{place} + j] > 0.0"
        return {"joints": f"if {here}:\n    force = {limited}\n"}
    mark, total, *moves = _MOVES[piece.role]
    x, v = (_chosen(move, piece.at, place) for move in moves)
    looked = [f"p[{seen}]"] if piece.past else []
    arguments = ", ".join(
        [f"x_{number}", f"v_{number}", "seat", *looked, *drives, *states, *constants[bool(piece.past) :]]
    )
    results = ", ".join([f"added_{number}", *(f"d{name}" for name in states)])
    lines = {
        "before": f"x_{number} = {x}\nv_{number} = {v}\n{results} = _piece_{number}({arguments})\n",
        mark: _where(piece.at, place, f"added_{number}", total),
        "samples": "",
    }
    if drives:
        drive_lines = ""
        for slope, q, column in zip(slopes, drives, piece.drives, strict=True):
            lines["samples"] += f"{slope} = (drive[n, {column}] - {q}) / (step_s * substeps)\nd1{q[1:]} = {slope}\n"
            drive_lines += f"d{q} = {slope}\n"
        lines["before"] = drive_lines + lines["before"]
    if piece.past:
        stretch = x
        for name, ahead in (("middle", 0.5), ("end", 1.0)):
            lines[name] = f"p[{seen}] = _look_back(p, {seen + 1}, {piece.past}, {constants[0]} - {ahead})\n"
        lines["past"] = f"p[{seen + 1}] += 1.0\np[{seen + 2} + int(p[{seen + 1}]) % {piece.past}] = {stretch}\n"
    return lines


_MOVES: Final = {
    "force of a joint": ("joints", "force", "x[{j}] - x[{i}]", "v[{j}] - v[{i}]"),
    "force on a segment": ("segments", "load", "x[{j}]", "v[{j}]"),
}


def _chosen(motion: str, at: int, place: int) -> str:
    """The motion where a piece sits, a place known or by the ones and zeros from p[place] on."""
    each = [motion[:1] + "[0]", *(motion.format(j=j, i=j - 1) for j in range(1, N_SEGMENTS))]
    return each[at] if at != ANYWHERE else " + ".join(f"p[{place + j}] * ({one})" for j, one in enumerate(each))


def _where(at: int, place: int, added: str, total: str) -> str:
    """The line that adds to a total where a piece sits."""
    if at != ANYWHERE:
        return f"if j == {at}:\n    {total} += {added}\n"
    return f"{total} += p[{place} + j] * {added}\n"


_LOOK_BACK: Final = '''@compiled
def _look_back(p: Floats, at: int, length: int, steps: float) -> float:
    """The ring behind p[at], so many steps before the last of p[at] in all; straight between steps, 0 before them."""
    wanted = p[at] - steps
    if wanted <= 0.0:
        return 0.0
    first = int(wanted)
    earlier = p[at + 1 + first % length] if first > 0 else 0.0
    return earlier + (wanted - first) * (p[at + 1 + (first + 1) % length] - earlier)


'''


def _renamed(function: Callable[..., Any], number: int) -> str:
    """The source of a function as `_piece_<number>`, to be compiled by itself: LLVM inlines it."""
    source = textwrap.dedent(inspect.getsource(function))
    return "@compiled\n" + re.sub(rf"def {function.__name__}\(", f"def _piece_{number}(", source, count=1) + "\n\n"


@functools.cache
def _load(text: str) -> Callable[..., None]:
    """The integrator of a source text, from a file of the user's own where one can be kept."""
    name = f"chain_{hashlib.sha256(text.encode()).hexdigest()[:32]}"
    module = types.ModuleType(f"biodyn_generated.{name}")
    if CACHE is None:
        exec(compile(text, name, "exec"), module.__dict__)  # noqa: S102 - made here from our own source
    else:
        path = kept(Path(CACHE) / "generated" / f"{name}.py", text)
        spec = importlib.util.spec_from_file_location(module.__name__, path)
        if spec is None or spec.loader is None:
            raise ImportError(f"{path}: cannot be loaded")
        module = importlib.util.module_from_spec(spec)
        sys.modules[module.__name__] = module  # numba looks its functions' modules up
        spec.loader.exec_module(module)
    found: Callable[..., None] = module.integrate_chain
    return found


def kept(path: Path, text: str) -> Path:
    """A file with just this text; not touched where it is there already, since numba's cache goes by its date."""
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    if not (path.is_file() and path.read_text(encoding="utf-8") == text):
        part = path.with_name(f".{path.name}.{os.getpid()}.part")
        part.write_text(text, encoding="utf-8")
        part.replace(path)
    return path
