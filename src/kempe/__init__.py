"""Kempe answers position questions about multibody systems.

They may be open chains, trees or closed loops, in the plane or in space.

``describe or load -> Mechanism -> build -> System -> forward, inverse, ...``. Methods of `System`
are the map.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from importlib import import_module
from typing import TYPE_CHECKING, Any

from kempe import errors, spatial
from kempe.arguments import explain_errors
from kempe.description.mechanism import Mechanism
from kempe.errors import Interrupted, KempeError
from kempe.system import System
from kempe.version import __version__ as __version__

if TYPE_CHECKING:
    from pathlib import Path

    from kempe import constraints, convert, tasks
    from kempe.budget import Budget, Tolerance
    from kempe.description.dh import from_dh, from_screws
    from kempe.status import Status
    from kempe.workspace.answer import open_workspace
    from kempe.workspace.map_file import map_file

deg = math.pi / 180.0
"""A degree in radians: 90 * kempe.deg."""
mm = 1e-3
"""A millimetre in metres: 500 * kempe.mm."""

__all__ = [
    "Budget",
    "Interrupted",
    "KempeError",
    "Mechanism",
    "Status",
    "System",
    "Tolerance",
    "constraints",
    "convert",
    "deg",
    "errors",
    "from_dh",
    "from_screws",
    "load",
    "map_file",
    "mm",
    "open_workspace",
    "read",
    "spatial",
    "tasks",
]


@explain_errors
def load(
    source: str | Path | bytes,
    *,
    format: str | None = None,
    base: str | None = None,
    root: str | None = None,
    model: str | None = None,
    package_dirs: Iterable[str | Path] = (),
    xacro: bool | Mapping[str, str | float] = False,
    lenient_limits: bool = False,
    srdf: str | Path | None = None,
) -> System:
    """Load a `System` from a file (path), a text, or a shipped model (bare name such as "puma560").

    Formats are those of `kempe.description.formats.FORMATS`, found out by ending and contents where
    `format` is None. `base="free"` lets the root link of a URDF move freely, or what nothing ties
    to the world of an SDF; `root` names the ground where a file has no root link; `model` names the
    model that is read of an SDF with several; `package_dirs` are folders in which meshes, packages
    and the files that MJCF includes are looked up, beside the file's package, its neighbours, and
    the folders of ROS; `xacro=True` expands xacro first, `xacro={"name": "ur5e"}` with these values
    of its ``<xacro:arg>`` elements; `lenient_limits=True` reads limits of a URDF that hold no range (no
    bounds, or lower above upper), and negative ones of velocity and effort, as none; `srdf`
    is the SRDF of a URDF, with groups, postures, end effectors and how the base moves. Errors:
    `DescriptionError` with file, line and what is allowed.
    """
    from kempe.description.source import pause_garbage_collection

    with pause_garbage_collection():
        return read(
            source,
            format=format,
            base=base,
            root=root,
            model=model,
            package_dirs=package_dirs,
            xacro=xacro,
            lenient_limits=lenient_limits,
            srdf=srdf,
        ).build()


def read(
    source: str | Path | bytes,
    *,
    format: str | None = None,
    base: str | None = None,
    root: str | None = None,
    model: str | None = None,
    package_dirs: Iterable[str | Path] = (),
    xacro: bool | Mapping[str, str | float] = False,
    lenient_limits: bool = False,
    srdf: str | Path | None = None,
) -> Mechanism:
    """Read a file, text or model as `load` does, and return the `Mechanism`, to change or write it."""
    from kempe.description.read import read_mechanism

    return read_mechanism(
        source,
        format=format,
        base=base,
        root=root,
        model=model,
        package_dirs=package_dirs,
        xacro=xacro,
        lenient_limits=lenient_limits,
        srdf=srdf,
    )


def __getattr__(name: str) -> Any:
    if name in ("from_dh", "from_screws"):
        from kempe.description import dh

        return getattr(dh, name)
    if name == "map_file":
        from kempe.workspace.map_file import map_file

        return map_file
    if name == "open_workspace":
        from kempe.workspace.answer import open_workspace

        return open_workspace
    if name in ("Budget", "Tolerance"):
        from kempe import budget

        return getattr(budget, name)
    if name == "Status":
        return import_module("kempe.status").Status
    if name in ("constraints", "convert", "tasks"):
        return import_module(f"kempe.{name}")
    raise AttributeError(f"module 'kempe' has no attribute {name!r}")
