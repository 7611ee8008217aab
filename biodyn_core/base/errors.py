"""Errors of input, in contrast to every other error, which is one of the code."""

from __future__ import annotations

from typing import Final

MAX_CHARACTERS: Final = 1000
"""Of one line: a wrong value may have any length, a name thousands of characters."""


class InputError(ValueError):
    """Bad input, in one line: the fault, its place, the allowed values, and the remedy.

    The command line prints it and exits with code 2; a node logs it and does not start.
    """

    def __init__(self, text: str) -> None:
        cut = (
            f"{text[: MAX_CHARACTERS // 2]} ... {text[5 - MAX_CHARACTERS // 2 :]}"
            if len(text) > MAX_CHARACTERS
            else text
        )
        super().__init__(cut)


class UnusableRecording(InputError):
    """A recording that can be read but not compared with a model; of several recordings the others are used."""


def one_line(error: Exception) -> str:
    """An error in one line, with the type of an error that is no InputError."""
    line = " ".join(str(error).split())
    return line if isinstance(error, InputError) else f"{type(error).__name__}: {line}"
