"""The seated body: parameters and subject, matrices and joint laws, the chain and its synthetic recordings.

`Chain`, `Subject` and `load_subject` are public under this name. They load on first use, because the settings in this
package are read where numpy is not yet needed.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from biodyn_core.body.model import Chain
    from biodyn_core.body.subject import Subject, load_subject

__all__ = ["Chain", "Subject", "load_subject"]

_MODULES = {"Chain": "model", "Subject": "subject", "load_subject": "subject"}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
