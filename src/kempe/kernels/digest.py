"""Which sources a library of kernels was built from."""

from __future__ import annotations

import hashlib
from pathlib import Path

HERE = Path(__file__).parent


def sources(folder: Path = HERE) -> dict[str, str]:
    """For each source of kernels by its name, which is unique, the name of the module from the
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


def source_digests(folder: Path = HERE) -> str:
    """A line for each source of kernels: name and digest (SHA-256) of what it says; empty where
    there are none.
    """
    lines = []
    for name in sources(folder).values():
        path = name.replace(".", "/")
        lines.append(f"{path} {_digest(folder / f'{path}.py')}\n")
    return "".join(lines)


def _digest(path: Path) -> str:
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        return f"unreadable: {error.strerror}"


def first_difference(before: str, now: str) -> str:
    """The name of the first source that is not in both of two such texts with the same digest."""
    (name, *_) = sorted(set(before.splitlines()) ^ set(now.splitlines()))[0].split()
    return f"{name.replace('.', '/')}.py"
