"""Names that lower layers use of higher ones, as text; their modules are imported on first use.

`Mechanism.build` makes a `System`, answers are explained by the verb that gave them, and are drawn.
All other imports point from a layer to those below it.
"""

from __future__ import annotations

from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from kempe.system import System as System  # the type of what `Mechanism.build` returns

ROWS = {
    "System": "kempe.system:System",
    "read_urdf": "kempe.description.urdf_reader:read_urdf",
    "write_urdf": "kempe.description.urdf_writer:write_urdf",
    "read_mjcf": "kempe.description.mjcf_reader:read_mjcf",
    "read_sdf": "kempe.description.sdf_reader:read_sdf",
    "write_sdf": "kempe.description.sdf_writer:write_sdf",
    "read_toml": "kempe.description.toml_reader:read_toml",
    "write_toml": "kempe.description.toml_writer:write_toml",
    "write": "kempe.description.read:write_mechanism",
    "convert_unit": "kempe.description.length_units:convert_unit",
    "assemble": "kempe.assemble.assemble:assemble",
    "way_there": "kempe.motion.manoeuvre:describe_way_there",
    "answers of assemble": "kempe.assemble.explain:ROW",
    "answers of ik": "kempe.inverse.explain:ROW",
    "answers of ik, tasks": "kempe.inverse.explain_tasks:ROW",
    "answers of ik_all": "kempe.inverse.explain_all:ROW",
    "plots": "kempe.views.plots:",
    "films": "kempe.views.films:",
    "plots of singularities": "kempe.views.singular_plot:",
    "plots of workspaces": "kempe.views.workspace_plot:",
}
"""Names, and where they are: ``module:member``, or ``module:`` for the module itself."""


@cache
def import_late_member(name: str) -> Any:
    """Import the module or the member of a module that a row of `ROWS` names."""
    module, _, member = ROWS[name].partition(":")
    found = import_module(module)
    return getattr(found, member) if member else found


def call_late_function(name: str, *args: Any, **options: Any) -> Any:
    """Call the function that a row of `ROWS` names, and return its result."""
    return import_late_member(name)(*args, **options)
