"""Digests of the sources of the kernels, which tell from which sources a library was built."""

from __future__ import annotations

import hashlib
from pathlib import Path

HERE = Path(__file__).parent


def list_sources(folder: Path = HERE) -> dict[str, str]:
    """Return, for each source of kernels by its unique name, the name of the module from the
    package on.

    Files whose names no import could name, as editors leave them, do not count.
    """
    found: dict[str, str] = {}
    for path in sorted(folder.rglob("*.py")):
        parts = path.relative_to(folder).with_suffix("").parts
        if (
            all(part.isidentifier() for part in parts)
            and "__pycache__" not in parts
            and path.is_file()
        ):
            found[".".join(parts) if path.stem == "__init__" else path.stem] = ".".join(parts)
    return found


def compute_source_digests(folder: Path = HERE) -> str:
    """Return a text with a line for each source of kernels, its name and digest (SHA-256); empty
    where there are no sources.
    """
    lines = []
    for name in list_sources(folder).values():
        path = name.replace(".", "/")
        lines.append(f"{path} {_compute_digest(folder / f'{path}.py')}\n")
    return "".join(lines)


def _compute_digest(path: Path) -> str:
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        return f"unreadable: {error.strerror}"


def find_first_difference(before: str, now: str) -> str:
    """Return the name of the first source whose digest differs between two texts of digests."""
    (name, *_) = sorted(set(before.splitlines()) ^ set(now.splitlines()))[0].split()
    return f"{name.replace('.', '/')}.py"
