"""Effect assembly: the effects of a chain in its integrator, with their constants, states and memory."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.base.errors import InputError
from biodyn_core.effects import ChainEffect, JointForce, JointLimit, SegmentForce, StepBounds
from biodyn_core.kernels.generated import Piece, Role, integrator

_NO_DRIVE: Final = np.empty((0, 0))
_ROLES: Final[Mapping[type[ChainEffect], Role]] = {
    JointForce: "force of a joint",
    JointLimit: "limit of a joint",
    SegmentForce: "force on a segment",
}


@dataclass(frozen=True)
class Element:
    """An effect in a chain, with its constants, the channels it needs and its delay.

    index is its segment or joint, 0 to 5; a spread (6,), if not empty, distributes the force over all segments instead.
    """

    effect: ChainEffect
    index: int
    constants: tuple[float, ...]
    channels: tuple[str, ...]
    delay_s: float
    bounds: StepBounds
    spread: tuple[float, ...]


class EffectAssembly:
    """The integrator of some elements for one step size; its array p holds their constants and their memory."""

    def __init__(self, elements: Sequence[Element], step_s: float) -> None:
        self.channels = tuple(dict.fromkeys(name for element in elements for name in element.channels))
        pieces = [_piece(element, self.channels, step_s) for element in elements]
        self.integrate = integrator(pieces)
        self.states = sum(piece.all_states for piece in pieces)
        self.p = np.concatenate([np.empty(0), *map(_constants, elements, pieces, [step_s] * len(pieces))])
        self._at_rest = self.p.copy()
        self._driven = _drive_states(pieces)

    def begin(self, states: Floats, drive: Floats) -> None:
        """Set states (s,) and memory to rest, and the drives to the first row of drive (n, d)."""
        states[:] = 0.0
        self.p[:] = self._at_rest
        for place, column in self._driven:
            states[place] = drive[0, column]

    def drive(self, channels: Mapping[str, Floats] | None) -> Floats:
        """The channels that the elements need, (n, d), or (0, 0); raises InputError for a missing one."""
        if not self.channels:
            return _NO_DRIVE
        found = channels or {}
        for name in self.channels:
            if name not in found:
                raise InputError(f"an effect needs the channel {name}, which is not measured here")
        # Masked samples count as zero.
        return np.ascontiguousarray(np.column_stack([np.nan_to_num(found[name]) for name in self.channels]))


def _piece(element: Element, channels: Sequence[str], step_s: float) -> Piece:
    """The piece of the integrator for an element."""
    effect = element.effect
    drives = tuple(channels.index(name) for name in element.channels)
    # A memory for the longest delay serves every delay with the same source text.
    past = math.ceil(effect.longest_delay_s / step_s) + 3 if effect.longest_delay_s > 0.0 else 0
    role, constants = _ROLES[type(effect)], len(element.constants)
    return Piece(role, effect.law, effect.states, constants, drives, past, bool(element.spread))


def _constants(element: Element, piece: Piece, step_s: float) -> Floats:
    steps = (max(element.delay_s / step_s, 1.0),) if piece.past else ()
    here = element.spread or (float(element.index),)
    return np.array([*here, *steps, *element.constants, *[0.0] * piece.memory])


def _drive_states(pieces: Sequence[Piece]) -> list[tuple[int, int]]:
    """Pairs of a state and the column of the drive that it starts from."""
    found, state = [], 0
    for piece in pieces:
        found += [(state + i, column) for i, column in enumerate(piece.drives)]
        state += piece.all_states
    return found
