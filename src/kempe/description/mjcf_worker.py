"""Conversion of an MJCF text to plain data by MuJoCo's compiler.

This file is run as a program of its own, in a process with limits (`kempe.description.mjcf_text`),
and imports nothing of Kempe.
"""

from __future__ import annotations

import base64
import json
import os
import sys
from contextlib import suppress
from importlib import import_module
from typing import Any

TINY = 1e-14
"""Mass and inertia of bodies that have none; MuJoCo refuses less than 1e-15."""

TETRAHEDRON = [0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1]
"""Vertices that stand for those of a mesh, which is not read."""


def compile_model(text: str, files: dict[str, bytes]) -> dict[str, Any]:
    """Return the tables of a model, or the error of MuJoCo.

    The result is ``{"error": ...}`` with the message of MuJoCo where the text is wrong, and
    ``{"missing": ...}`` where its version lacks something; `files` by name are those that the text
    needs while it is parsed.
    """
    mujoco: Any = import_module("mujoco")
    try:
        spec = mujoco.MjSpec.from_string(text, include=files)
        what = _strip_spec(mujoco, spec)
        model = spec.compile()
    except (ValueError, RuntimeError, mujoco.FatalError) as error:
        return {"error": str(error)}
    except AttributeError as error:
        return {"missing": f"mujoco {mujoco.__version__}: {error}"}
    return _build_tables(mujoco, spec, model, what)


def _strip_spec(mujoco: Any, spec: Any) -> dict[str, Any]:
    """Remove from a spec what would be read from files or cost time, and return what was there."""
    for mesh in spec.meshes:
        # older versions name a mesh after its file no sooner than they read it
        mesh.name = mesh.name or os.path.splitext(os.path.basename(mesh.file))[0]
    out: dict[str, Any] = {
        "actuators": len(spec.actuators),
        "sensors": len(spec.sensors),
        "flexes": [f.name for f in spec.flexes],
        "plugins": [p.name or p.plugin_name for p in spec.plugins],
        "meshes": {m.name: _describe_mesh(spec, m) for m in spec.meshes},
        "shapes": [_replace_mesh_geom(mujoco, g) for g in spec.geoms],
    }
    for size in ("memory", "nstack", "njmax", "nconmax"):
        # the memory of a simulation; not all versions leave all of it open
        with suppress(TypeError, AttributeError):
            setattr(spec, size, -1)
    # a search of seconds, for muscles
    spec.compiler.LRopt.mode = mujoco.mjtLRMode.mjLRMODE_NONE
    for body in spec.bodies:
        body.plugin.active = False
        settings = body.compiler
        settings.boundmass = max(settings.boundmass, TINY)
        settings.boundinertia = max(settings.boundinertia, TINY)
        settings.discardvisual = False
    for key in spec.keys:
        key.ctrl = key.act = []
    for mesh in spec.meshes:
        _remove_mesh_file(mesh)
    for texture in spec.textures:
        _simplify_texture(mujoco, texture)
    plugged = [x for x in (*spec.actuators, *spec.sensors) if x.plugin.active]
    for item in (*plugged, *spec.skins, *spec.hfields):
        spec.delete(item)
    return out


def _remove_mesh_file(mesh: Any) -> None:
    """Replace the file of a mesh by a tetrahedron."""
    if mesh.file or mesh.plugin.active:
        mesh.plugin.active = False
        mesh.file = ""
        mesh.content_type = ""
        mesh.scale = [1, 1, 1]
        mesh.uservert = TETRAHEDRON
        mesh.userface = mesh.usernormal = mesh.usertexcoord = []


def _simplify_texture(mujoco: Any, texture: Any) -> None:
    """Replace a texture from a file by a texture of a single colour."""
    if not texture.file and not any(texture.cubefiles):
        return
    texture.file = ""
    texture.content_type = ""
    for k in range(len(texture.cubefiles)):
        texture.cubefiles[k] = ""
    texture.builtin = mujoco.mjtBuiltin.mjBUILTIN_FLAT
    texture.data = b""
    texture.width = texture.height = 1
    texture.nchannel = 3


def _describe_mesh(spec: Any, mesh: Any) -> dict[str, Any]:
    """Return the file, folder, scale and line of a mesh."""
    moved = [*mesh.refpos, *mesh.refquat] != [0, 0, 0, 1, 0, 0, 0]
    return {
        "file": mesh.file,
        "folder": mesh.compiler.meshdir,
        "strip": bool(getattr(spec, "strippath", False)),
        "scale": [float(x) for x in mesh.scale],
        "line": _get_line(mesh),
        "moved": moved,
    }


def _replace_mesh_geom(mujoco: Any, geom: Any) -> dict[str, Any]:
    """Replace a geom that needs files by a small sphere with the same frame, and describe the geom."""
    types = mujoco.mjtGeom
    kind = geom.type
    mesh = geom.meshname
    heavy = kind in (types.mjGEOM_MESH, types.mjGEOM_SDF, types.mjGEOM_HFIELD) or bool(mesh)
    geom.plugin.active = False
    # a mass that is given is known, and a density of 0 means none
    weighs = heavy and geom.mass != 0 and not (geom.mass != geom.mass and geom.density == 0)
    if heavy:
        geom.type = types.mjGEOM_SPHERE
        geom.size = [1e-3, 0, 0]
        geom.meshname = ""
        geom.hfieldname = ""
        geom.mass = 0
        geom.fromto = [float("nan")] * 6
    return {
        "kind": str(kind).rpartition("_")[2].lower(),
        "mesh": mesh,
        "weighs": weighs,
        "element": geom,
    }


def _get_line(element: Any) -> int:
    """Return the line of an element; 0 where it is unknown."""
    words = element.info.replace(",", " ").split()
    return int(words[words.index("line") + 1]) if "line" in words else 0


def _build_tables(mujoco: Any, spec: Any, model: Any, what: dict[str, Any]) -> dict[str, Any]:
    """Return the tables of the compiled model: bodies, joints, sites, geoms and more."""
    types = mujoco.mjtObj

    def get_name(kind: Any, i: int) -> str:
        """Return the name of an object of the model; '' where it has none."""
        return mujoco.mj_id2name(model, kind, i) or ""

    def list_lines(elements: Any) -> dict[int, int]:
        """Return the lines of elements by their numbers in the model."""
        return {e.id: _get_line(e) for e in elements}

    joint_lines = list_lines(spec.joints)
    joints = [
        {
            "name": get_name(types.mjOBJ_JOINT, j),
            "kind": ("free", "ball", "slide", "hinge")[int(model.jnt_type[j])],
            "body": int(model.jnt_bodyid[j]),
            "address": int(model.jnt_qposadr[j]),
            "pos": model.jnt_pos[j].tolist(),
            "axis": model.jnt_axis[j].tolist(),
            "range": model.jnt_range[j].tolist() if model.jnt_limited[j] else None,
            "line": joint_lines.get(j, 0),
        }
        for j in range(model.njnt)
    ]
    weightless = _list_weightless_bodies(spec, what["shapes"])
    bodies = [
        {
            "name": get_name(types.mjOBJ_BODY, b.id),
            "parent": int(model.body_parentid[b.id]),
            "pos": model.body_pos[b.id].tolist(),
            "quat": model.body_quat[b.id].tolist(),
            "mass": _get_mass(model, b, weightless),
            "center": model.body_ipos[b.id].tolist(),
            "mocap": int(model.body_mocapid[b.id]) >= 0,
            "line": _get_line(b),
        }
        for b in sorted(spec.bodies, key=lambda b: b.id)
    ]
    site_lines = list_lines(spec.sites)
    sites = [
        {
            "name": get_name(types.mjOBJ_SITE, s),
            "body": int(model.site_bodyid[s]),
            "pos": model.site_pos[s].tolist(),
            "quat": model.site_quat[s].tolist(),
            "line": site_lines.get(s, 0),
        }
        for s in range(model.nsite)
    ]
    shapes = {shape.pop("element").id: shape for shape in what.pop("shapes")}
    geom_lines = list_lines(spec.geoms)
    geoms = [
        {
            **shapes[g],
            "name": get_name(types.mjOBJ_GEOM, g),
            "body": int(model.geom_bodyid[g]),
            "size": model.geom_size[g].tolist(),
            "pos": model.geom_pos[g].tolist(),
            "quat": model.geom_quat[g].tolist(),
            "color": _find_color(model, g),
            "group": int(model.geom_group[g]),
            "touches": bool(model.geom_contype[g] or model.geom_conaffinity[g]),
            "line": geom_lines.get(g, 0),
        }
        for g in range(model.ngeom)
        if g in shapes
    ]
    equality_lines = list_lines(spec.equalities)
    disabled = bool(model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_EQUALITY)
    equalities = [
        {
            "name": get_name(types.mjOBJ_EQUALITY, e),
            "kind": str(mujoco.mjtEq(int(model.eq_type[e]))).rpartition("_")[2].lower(),
            "active": bool(model.eq_active0[e]) and not disabled,
            "a": int(model.eq_obj1id[e]),
            "b": int(model.eq_obj2id[e]),
            "sites": int(model.eq_objtype[e]) == int(types.mjOBJ_SITE),
            "data": model.eq_data[e].tolist(),
            "line": equality_lines.get(e, 0),
        }
        for e in range(model.neq)
    ]
    tendon_lines = list_lines(spec.tendons)
    tendons = [
        {
            "name": get_name(types.mjOBJ_TENDON, t),
            "joints": _list_tendon_joints(mujoco, model, t),
            "length": float(model.tendon_length0[t]),
            "range": model.tendon_range[t].tolist() if model.tendon_limited[t] else None,
            "line": tendon_lines.get(t, 0),
        }
        for t in range(model.ntendon)
    ]
    key_lines = list_lines(spec.keys)
    keys = [
        {
            "name": get_name(types.mjOBJ_KEY, k),
            "qpos": model.key_qpos[k].tolist(),
            "line": key_lines.get(k, 0),
        }
        for k in range(model.nkey)
    ]
    return {
        **what,
        "name": spec.modelname,
        "qpos0": model.qpos0.tolist(),
        "bodies": bodies,
        "joints": joints,
        "sites": sites,
        "geoms": geoms,
        "equalities": equalities,
        "tendons": tendons,
        "keys": keys,
    }


def _find_color(model: Any, g: int) -> list[float] | None:
    """Return the colour of a geom or of its material; None for the default colour of MuJoCo."""
    own = model.geom_rgba[g].tolist()
    material = int(model.geom_matid[g])
    if own != [0.5, 0.5, 0.5, 1.0]:
        return own
    return model.mat_rgba[material].tolist() if material >= 0 else None


def _list_weightless_bodies(spec: Any, shapes: list[dict[str, Any]]) -> set[int]:
    """Return the numbers of the bodies whose mass is unknown, since a mesh is not read."""
    found = {shape["element"].parent.id for shape in shapes if shape["weighs"]}
    scaled = found and spec.compiler.settotalmass > 0
    return {body.id for body in spec.bodies} if scaled else found


def _get_mass(model: Any, body: Any, weightless: set[int]) -> float | None:
    """Return the mass of a body [kg]; None where it has none or where it follows from a mesh."""
    stated = body.explicitinertial and int(body.compiler.inertiafromgeom) != 1
    stated = stated and body.compiler.settotalmass <= 0
    mass = float(model.body_mass[body.id])
    return None if mass <= 2 * TINY or (body.id in weightless and not stated) else mass


def _list_tendon_joints(mujoco: Any, model: Any, t: int) -> list[tuple[int, float]] | None:
    """Return the joints of a fixed tendon with their coefficients; None for a spatial tendon."""
    first = int(model.tendon_adr[t])
    parts = range(first, first + int(model.tendon_num[t]))
    if any(int(model.wrap_type[i]) != int(mujoco.mjtWrap.mjWRAP_JOINT) for i in parts):
        return None
    return [(int(model.wrap_objid[i]), float(model.wrap_prm[i])) for i in parts]


def write_compiled_model(settings: dict[str, Any]) -> None:
    """Compile the model in `settings` and write its tables to standard output as JSON.

    From the import of MuJoCo on the process can open no file: what the text names is in `settings`,
    or is not read.
    """
    import resource

    import_module("mujoco")
    files = {name: base64.b64decode(data) for name, data in settings["files"].items()}
    resource.setrlimit(resource.RLIMIT_NOFILE, (0, 0))
    answer = compile_model(settings["text"], files)
    sys.stdout.buffer.write(json.dumps(answer).encode())
    sys.stdout.flush()
