"""Where the meshes of a model lie. Their paths come from a file that is not trusted."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from pathlib import Path, PurePosixPath

from kempe.description.source import shorten
from kempe.errors import InputError


def resolve_mesh(path: str, roots: Iterable[str | Path]) -> Path:
    """The file that a mesh path of a model means: an existing file inside one of the folders
    `roots`.

    ``package://name/rest`` is looked for as ``name/rest`` in each root, and as ``rest`` in a root
    that is called `name`; any other path is relative to a root. Errors: `InputError` for absolute
    paths, ``..``, other schemes than package, links that lead out of their root, and files that do
    not exist.
    """
    folders = [Path(root) for root in roots]
    subject = f"mesh {shorten(path)}"
    scheme = re.match(r"([A-Za-z][A-Za-z0-9+.-]*)://", path)
    if scheme and scheme[1] != "package":
        raise InputError(
            f"{subject}: {scheme[0]} is not followed; a mesh is package://name/... or relative to "
            "the model"
        )
    inner = path.removeprefix("package://") if scheme else path
    parts = PurePosixPath(inner.replace("\\", "/")).parts
    if not parts or "\0" in path:
        raise InputError(f"{subject}: it names no file")
    if inner.startswith(("/", "\\", "~")) or re.match(r"[A-Za-z]:", inner):
        raise InputError(
            f"{subject}: it is absolute; a mesh is package://name/... or relative to the model"
        )
    if ".." in parts:
        raise InputError(
            f"{subject}: '..' could lead out of the model's folders and is not followed"
        )
    for root in folders:
        candidates = [root.joinpath(*parts)]
        if scheme and root.resolve().name == parts[0]:
            candidates.append(root.joinpath(*parts[1:]))
        for candidate in candidates:
            if os.path.isfile(candidate):
                real = candidate.resolve()
                if not real.is_relative_to(root.resolve()):
                    raise InputError(f"{subject}: it is a link that leads out of {str(root)!r}")
                return real
    looked = ", ".join(repr(str(f)) for f in folders) or "no folder: declare some by package_dirs"
    raise InputError(f"{subject}: there is no such file; looked in {looked}")
