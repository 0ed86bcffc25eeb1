"""Writer of TOML text without loss: `read_toml(write_toml(m)) == m`, to the last bit."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

import numpy as np

from kempe.arrays import is_mapping, is_sequence
from kempe.constraints.base import NUMBERS, End, list_expressions, list_fields, list_number_fields
from kempe.constraints.tape import TEXT_LIMIT, Tape
from kempe.description.formats import TOML
from kempe.description.mechanism import BETWEEN, Mechanism
from kempe.description.parts import Body, Declared, Frame, Joint, Shape
from kempe.description.source import Findings
from kempe.description.toml_document import FORMAT, NEWEST
from kempe.errors import DescriptionError, Fault, InputError
from kempe.joints import is_table_type
from kempe.poses import Placement, place
from kempe.units import METRE
from kempe.values import Expression

_BARE = re.compile(r"[A-Za-z0-9_-]+")
_ESCAPES = {
    "\\": "\\\\",
    '"': '\\"',
    "\n": "\\n",
    "\t": "\\t",
    "\r": "\\r",
    "\b": "\\b",
    "\f": "\\f",
}
_NEEDS_ESCAPE = re.compile(r'[\x00-\x1f\x7f"\\]')
_NOT_LITERAL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f]|'''|'$")


def write_toml(mechanism: Mechanism) -> str:
    """Return the TOML text of a mechanism with its parameters and expressions, for `read_toml`.

    Errors: `DescriptionError` listing all that a file cannot hold, by `TOML.cannot` of
    `kempe.description.formats`.
    """
    m = mechanism
    findings = Findings()
    constraints: list[dict[str, Any]] = []
    for c in m.constraints.values():
        with findings.record_errors(f"constraint {c.name!r}", c.where):
            constraints.append(_make_constraint_table(c, m.dim))
    shapes = [_make_shape_table(b.name, s, m.dim) for b in m.bodies.values() for s in b.shapes]
    newer = (
        shapes
        or m.groups
        or m.ignored_pairs
        or m.unit != METRE
        or any("parent" not in table for table in constraints)
    )
    version = NEWEST if newer else FORMAT
    head: dict[str, Any] = {
        "format": version,
        "name": m.name,
        "dim": m.dim,
        "ground": m.ground.name,
        "unit": m.unit,
        "notes": list(m.notes),
    }
    defaults: dict[str, Any] = {"dim": 3, "ground": "ground", "unit": METRE, "notes": []}
    if m.ignored_pairs:
        pairs = m.ignored_pairs.items()
        head["ignored_pairs"] = [(*pair, reason) if reason else pair for pair, reason in pairs]
    head |= {} if m.tolerance is None else {"tolerance": m.tolerance}
    blocks = [_format_lines({k: v for k, v in head.items() if defaults.get(k) != v})]
    if m.parameters:
        blocks.append("[parameters]\n" + _format_lines(m.parameters))
    plain = Body(m.ground.name)
    bodies = (b for b in m.bodies.values() if replace(b, shapes=()) != plain)
    blocks += [_format_block("body", _make_body_table(b)) for b in bodies]
    for joint in m.joints.values():
        if is_table_type(joint.type):
            blocks.append(_format_block("joint", _make_joint_table(joint, m.dim)))
            continue
        allowed = TOML.cannot["joints of types that are not in the table of joints"]
        said = f"type {joint.type.type_name!r} is not in the table of joints"
        findings.add_problem(said, f"joint {joint.name!r}", joint.where, allowed)
    blocks += [_format_block("frame", _make_frame_table(f, m.dim)) for f in m.frames.values()]
    blocks += [_format_block("shape", table) for table in shapes]
    blocks += [_format_block("constraint", table) for table in constraints]
    for c in m.couplings.values():
        table = {"of": c.of, "sources": c.sources} | (
            {"offset": c.offset} if c.offset != 0.0 else {}
        )
        blocks.append(_format_block("coupling", table))
    if m.postures:
        blocks.append("[postures]\n" + _format_lines(m.postures))
    if m.groups:
        blocks.append("[groups]\n" + _format_lines(m.groups))
    if m.locks:
        blocks.append("[locks]\n" + _format_lines(m.locks))
    findings.raise_problems()
    return "\n".join(blocks)


def _format_block(kind: str, table: Mapping[str, Any]) -> str:
    """Return an element of an array of tables as text."""
    return f"[[{kind}]]\n{_format_lines(table)}"


def _format_lines(table: Mapping[str, Any]) -> str:
    """Return the keys and values of a table as lines."""
    return "".join(f"{_format_key(k)} = {_format_value(v)}\n" for k, v in table.items())


def _make_body_table(body: Body) -> dict[str, Any]:
    """Return the table of a body."""
    given = {
        "name": body.name,
        "particle": body.particle or None,
        "mass": body.mass,
        "center": body.center,
    }
    return {k: v for k, v in given.items() if v is not None}


def _make_frame_table(frame: Frame, dim: int) -> dict[str, Any]:
    """Return the table of a frame."""
    return {"name": frame.name, "body": frame.body, **_make_placement_keys(frame.X_BF, dim)}


def _make_shape_table(body: str, shape: Shape, dim: int) -> dict[str, Any]:
    """Return the table of a shape."""
    out: dict[str, Any] = {"body": body, "type": shape.kind}
    out |= {"name": shape.name} if shape.name else {}
    usual = {f.name: f.default for f in fields(shape.geometry)}
    out |= {name: x for name, x in shape.geometry.sizes.items() if x != usual[name]}
    out |= _make_placement_keys(shape.X_BS, dim)
    for key in ("visual", "collision"):
        if not getattr(shape, key):
            out[key] = False
    return out | ({"color": shape.color} if shape.color else {})


def _make_joint_table(joint: Joint, dim: int) -> dict[str, Any]:
    """Return the table of a joint."""
    out: dict[str, Any] = {
        "name": joint.name,
        "type": joint.type.type_name,
        "parent": joint.parent,
        "child": joint.child,
    }
    on_parent = _make_placement_keys(joint.X_PF, dim)
    on_child = _make_placement_keys(joint.X_CM, dim)
    # the child's axis is the parent's unless given
    if on_parent.get("axis") == on_child.get("axis"):
        on_child.pop("axis", None)
    elif "axis" in on_parent and "axis" not in on_child and "steps" not in on_child:
        on_child["axis"] = [0.0, 0.0, 1.0]
    out |= on_parent
    out |= {f"child_{k}": v for k, v in on_child.items()}
    for key, bounds in (
        ("limits", joint.limits),
        ("velocity", joint.velocity_limits),
        ("effort", joint.effort_limits),
    ):
        if bounds:
            out[key] = bounds[""] if "" in bounds else bounds
    if joint.actuated is not None:
        out["actuated"] = joint.actuated
    if joint.cut:
        out["cut"] = True
    return out | joint.type.options


def _make_constraint_table(constraint: Declared, dim: int) -> dict[str, Any]:
    """Return the table of a constraint.

    A constraint that is placed on bodies has the keys of joints.
    """
    out: dict[str, Any] = {"name": constraint.name}
    placed = next((k for k, kind in BETWEEN.items() if constraint.of.kind == kind), "")
    if placed and all(isinstance(e, End) for e in constraint.of.ends):
        out |= {"type": placed, "parent": constraint.parent, "child": constraint.child}
        if constraint.rod:
            (row,) = constraint.of.list_rows(dim)
            out["length"] = getattr(constraint.of, row.equal)
        X_PF = constraint.X_PF
        if "direction" in (own := list_number_fields(constraint.of)) and own["direction"] != (
            0.0,
            0.0,
            1.0,
        ):
            X_PF = X_PF @ Placement((("align", tuple(own["direction"])),))
        out |= _make_placement_keys(X_PF, dim)
        return out | {
            f"child_{k}": v for k, v in _make_placement_keys(constraint.X_CM, dim).items()
        }
    out["type"] = constraint.kind
    usual = {f.name: f.default for f in fields(constraint.of)}
    for key, how in list_fields(type(constraint.of)).items():
        x = getattr(constraint.of, key)
        if x is not None and not (
            isinstance(x, (str, bool, int, float, tuple)) and x == usual[key]
        ):
            out[key] = _convert_field(x, how, dim)
    return out


def _convert_field(x: Any, how: str, dim: int) -> Any:
    """Return a field of a constraint in a form that TOML can hold."""
    if isinstance(x, End):
        return {"body": x.body, **_make_placement_keys(x.X, dim)}
    if how in NUMBERS and not isinstance(x, (str, Expression)):
        return x if is_sequence(x) and list_expressions(x) else np.asarray(x).tolist()
    if callable(x):
        reason: Any = getattr(x, "reason", None)
        why = "" if reason is None else f", which cannot be recorded: {reason}"
        allowed = TOML.cannot["Python functions that are no expression"]
        raise DescriptionError(
            Fault(f"a file cannot hold the Python function {x!r}{why}", allowed=allowed)
        )
    if isinstance(x, Tape):
        said = f"a file cannot hold an expression of more than {TEXT_LIMIT} characters"
        raise DescriptionError(Fault(said, allowed=TOML.cannot["expressions that are too long"]))
    return str(x) if isinstance(x, (Body, Frame)) else x


def _make_placement_keys(X: Placement, dim: int) -> dict[str, Any]:
    """Return the keys of a placement: `at`, an orientation and `axis` where possible, else `steps`."""
    form = _find_plain_form(X, dim)
    try:
        if place(**form) == X:
            return form
    except InputError:
        pass
    return {"steps": [[motion, *numbers] for motion, numbers in X.steps]}


def _find_plain_form(X: Placement, dim: int) -> dict[str, Any]:
    """Return the arguments of `place` that the steps of X suggest."""
    form: dict[str, Any] = {}
    found = {motion: numbers for motion, numbers in X.steps}
    if found.keys() & {"x", "y", "z"}:
        at = [found.get(k, (0.0,))[0] for k in "xyz"]
        form["at"] = at[:2] if dim == 2 and at[2] == 0.0 else at
    if dim == 2 and "rz" in found:
        form["angle"] = found["rz"][0]
    elif found.keys() & {"rx", "ry", "rz"}:
        form["rpy"] = [found.get(k, (0.0,))[0] for k in ("rx", "ry", "rz")]
    if "quat_wxyz" in found:
        form["quat_wxyz"] = list(found["quat_wxyz"])
    if "matrix" in found:
        form["matrix"] = [list(found["matrix"][i : i + 3]) for i in (0, 3, 6)]
    if "align" in found:
        axis = list(found["align"])
        form["axis"] = axis[:2] if dim == 2 and axis[2] == 0.0 else axis
    return form


# ---- syntax of TOML


def _format_key(key: str) -> str:
    """Return a key, in quotes where TOML needs them."""
    return key if _BARE.fullmatch(key) else _quote_text(key)


def _format_text(text: str) -> str:
    """Return a text as a TOML string; a text of several lines as a literal string."""
    if "\n" in text and not _NOT_LITERAL.search(text):
        return f"'''\n{text}'''"
    return _quote_text(text)


def _quote_text(text: str) -> str:
    """Return a text in quotes with escaped characters."""
    return '"' + _NEEDS_ESCAPE.sub(lambda m: _ESCAPES.get(m[0], f"\\u{ord(m[0]):04x}"), text) + '"'


def _format_value(x: Any) -> str:
    """Return a value as TOML."""
    if isinstance(x, bool):
        return "true" if x else "false"
    if isinstance(x, (int, float)):
        return repr(x)
    if isinstance(x, Expression):
        return _format_text(x.text)
    if isinstance(x, str):
        return _format_text(x)
    if is_mapping(x):
        return "{" + ", ".join(f"{_format_key(k)} = {_format_value(v)}" for k, v in x.items()) + "}"
    return "[" + ", ".join(map(_format_value, x)) + "]"
