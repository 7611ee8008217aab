"""The one error that means "what was given is wrong", apart from every error that means "the code is wrong"."""

from __future__ import annotations

from typing import Final

LONGEST: Final = 1000
"""Characters of one line: what is wrong may be a value of any length, or a name of thousands of characters."""


class InputError(ValueError):
    """Bad input, told in one line: what is wrong, where, what is allowed, and what to do.

    The command line prints it and exits with code 2; a node logs it and does not start.
    """

    def __init__(self, text: str) -> None:
        cut = f"{text[: LONGEST // 2]} ... {text[5 - LONGEST // 2 :]}" if len(text) > LONGEST else text
        super().__init__(cut)


class UnusableRecording(InputError):
    """A recording that can be read but not compared with a model; where several are given, the others go on."""


def one_line(error: Exception) -> str:
    """An error in one line: our own texts say all there is, others need their kind."""
    line = " ".join(str(error).split())
    return line if isinstance(error, InputError) else f"{type(error).__name__}: {line}"
