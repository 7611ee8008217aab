"""The one error that means "what was given is wrong", apart from every error that means "the code is wrong"."""

from __future__ import annotations


class InputError(ValueError):
    """Bad input, told in one line: what is wrong, where, what is allowed, and what to do.

    The command line prints it and exits with code 2; a node logs it and does not start.
    """
