"""Digests: short hashes of plain data."""

from __future__ import annotations

import hashlib
import json


def digest(document: object) -> str:
    """A short hash of plain data, the same for the same content."""
    return hashlib.sha256(json.dumps(document, sort_keys=True, default=str).encode()).hexdigest()[:16]
