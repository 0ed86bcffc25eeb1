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
    unit: str | None = None,
) -> System:
    """Load a `System` from a file, a text, or a shipped model.

    Parameters
    ----------
    source
        Path of a file, a text or bytes, or the name of a shipped model, such as "puma560".
    format
        "urdf", "sdf", "mjcf" or "toml" (default: found out by the ending and the contents).
    base
        "free" gives the root link of a URDF, or the parts of an SDF that are not tied to the world,
        a free joint (default: the root link is the ground).
    root
        Name of the ground, where a URDF has no root link.
    model
        Name of the model that is read of an SDF with several.
    package_dirs
        Folders in which meshes, packages and the files that MJCF includes are looked up, besides
        the package of the file, its neighbours, and the folders of ROS.
    xacro
        True expands xacro first; a dict such as ``{"name": "ur5e"}`` also gives values of its
        ``<xacro:arg>`` elements (default: False). A xacro file is a program and must be trusted.
    lenient_limits
        Whether limits of a URDF or SDF that hold no range (no bounds, or lower above upper), and
        negative limits of velocity and effort, count as none (default: False: they are errors).
    srdf
        File of the SRDF of a URDF, with groups, postures, end effectors and how the base moves.
    unit
        Unit of length to which all is converted: "m", "cm", "mm" or "in" (default: the unit of the
        file, which is the metre but for TOML that declares another).

    Returns
    -------
    System
        The system.

    Raises
    ------
    DescriptionError
        If the description has problems, up to 20 with file, line and what is allowed.
    InputError
        If an argument is wrong, or an option is not one of the format.

    See Also
    --------
    read : return the `Mechanism`, to change or write it.

    Examples
    --------
    >>> import kempe
    >>> robot = kempe.load("puma560")
    >>> robot.coordinate_names
    ('q1', 'q2', 'q3', 'q4', 'q5', 'q6')
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
            unit=unit,
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
    unit: str | None = None,
) -> Mechanism:
    """Read a `Mechanism` from a file, a text, or a shipped model, to change or write it.

    Parameters
    ----------
    source
        Path of a file, a text or bytes, or the name of a shipped model, such as "puma560".
    format
        "urdf", "sdf", "mjcf" or "toml" (default: found out by the ending and the contents).
    base
        "free" gives the root link of a URDF, or the parts of an SDF that are not tied to the world,
        a free joint (default: the root link is the ground).
    root
        Name of the ground, where a URDF has no root link.
    model
        Name of the model that is read of an SDF with several.
    package_dirs
        Folders in which meshes, packages and the files that MJCF includes are looked up, besides
        the package of the file, its neighbours, and the folders of ROS.
    xacro
        True expands xacro first; a dict such as ``{"name": "ur5e"}`` also gives values of its
        ``<xacro:arg>`` elements (default: False). A xacro file is a program and must be trusted.
    lenient_limits
        Whether limits of a URDF or SDF that hold no range (no bounds, or lower above upper), and
        negative limits of velocity and effort, count as none (default: False: they are errors).
    srdf
        File of the SRDF of a URDF, with groups, postures, end effectors and how the base moves.
    unit
        Unit of length to which all is converted: "m", "cm", "mm" or "in" (default: the unit of the
        file, which is the metre but for TOML that declares another).

    Returns
    -------
    Mechanism
        The mechanism, not yet built.

    Raises
    ------
    DescriptionError
        If the description has problems, up to 20 with file, line and what is allowed.
    InputError
        If an argument is wrong, or an option is not one of the format.

    See Also
    --------
    load : return the `System`, with which everything is computed.

    Examples
    --------
    >>> import kempe
    >>> m = kempe.read("puma560")
    >>> kempe.load("puma560").nq, m.lock({"q6": 0.0}).build().nq
    (6, 5)
    """
    from kempe.description.read import read_mechanism

    mechanism = read_mechanism(
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
    if unit is None:
        return mechanism
    from kempe.description.length_units import convert_unit

    return convert_unit(mechanism, unit)


def __dir__() -> list[str]:
    """List the public names, those that are loaded when they are first used among them."""
    return sorted({*__all__, *(name for name in globals() if name.startswith("__"))})


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
    errors.raise_missing_name("kempe", name, __all__)
