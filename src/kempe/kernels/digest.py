"""Which sources a library of kernels was built from."""

from __future__ import annotations

import hashlib
from pathlib import Path


def source_digest(folder: Path = Path(__file__).parent) -> str:
    """Digest of all sources of kernels, names and contents; empty where there are none, as in a frozen program."""
    digest, paths = hashlib.sha256(), sorted(folder.rglob("*.py"))
    if not paths:
        return ""
    for path in paths:
        digest.update(f"{path.relative_to(folder).as_posix()}\0".encode() + path.read_bytes() + b"\0")
    return digest.hexdigest()
