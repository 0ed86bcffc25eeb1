"""Robot files against the peers: how long it takes to read one into a model that can be asked."""

from __future__ import annotations

import importlib.util
import tempfile
import warnings
from pathlib import Path
from typing import Any

import kempe
from kempe_bench import peers
from kempe_bench.bench import Bench
from kempe_bench.timing import Case, Grid, measure

URDF = ("panda.urdf", "tiago.urdf", "talos_full_v2.urdf")
SDF = ("cassie_v2.sdf",)
LOOPS = ("cassie.sdf", "cassie_v2.sdf")
"""CAD robots of six and of four loops."""
MJCF = ("testdata/model.xml",)
"""Files inside MuJoCo's package."""


def files(bench: Bench) -> Grid:
    """Time from the path of a file to a model."""
    table = Grid("Robot files: from the path to a model", "ms")
    ways = (
        (URDF, peers.robot_file, {"pin": _pinocchio, "drake": _drake}),
        (SDF, peers.robot_file, {"drake": _drake}),
        (MJCF, _of_mujoco, {"mujoco": _mujoco}),
    )
    for names, found, others in ways:
        for path in filter(None, map(found, names)):
            timed = [Case("Kempe", path.name, "load(path)", {"load": kempe.load, "path": path})]
            timed += [
                Case(who, path.name, "read(path)", {"read": read, "path": str(path)})
                for package, make in others.items()
                if package in bench.versions
                for who, read in [make()]
            ]
            table.rows += measure(timed, 1e3)
    for path in filter(None, map(peers.robot_file, LOOPS)):
        timed = [
            Case("Kempe", f"{path.name}, {what}", "answer(path)", {"answer": answer, "path": path})
            for what, answer in (("closed", _closed), ("page", _page))
        ]
        table.rows += measure(timed, 1e3)
    table.remarks += [
        "closed: read, and the first `assemble`, which also looks for the nearest mechanism that "
        "closes exactly; page: closed and written by `save_html`",
        "Kempe reads strictly, keeps shapes and notes, and finds loops; Pinocchio and Drake read no "
        "meshes here, MuJoCo compiles them",
        "Drake: parsed only, for it refuses to finalize a model with loops, as that of Cassie",
        "MJCF: Kempe calls MuJoCo's compiler in a process with limits, which has to start first",
    ]
    return table


def _closed(path: Path) -> tuple[kempe.System, Any]:
    """The system of a file, and a configuration that closes its loops."""
    system = kempe.load(path)
    return system, system.assemble().expect().q


def _page(path: Path) -> None:
    """Write a page with the closed system."""
    system, q = _closed(path)
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of meshes that are not drawn
        system.save_html(Path(folder) / "page.html", q)


def _of_mujoco(name: str) -> Path | None:
    """A file inside MuJoCo's package, or None."""
    found = importlib.util.find_spec("mujoco")
    path = Path(found.origin).parent / name if found and found.origin else None
    return path if path and path.is_file() else None


def _pinocchio() -> tuple[str, Any]:
    return "Pinocchio", peers.module("pinocchio").buildModelFromUrdf


def _mujoco() -> tuple[str, Any]:
    return "MuJoCo", peers.module("mujoco").MjModel.from_xml_path


def _drake() -> tuple[str, Any]:
    plant = peers.module("pydrake.multibody.plant").MultibodyPlant
    parser = peers.module("pydrake.multibody.parsing").Parser

    def read(path: str) -> Any:
        made = plant(0.0)
        parser(made).AddModels(path)
        return made

    return "Drake", read
