"""Each extra of pyproject.toml is complete: installed alone, in a fresh environment, it does what
it is for.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
from importlib.util import find_spec
from pathlib import Path

import pytest
from copies import once
from test_install import done, environment, folder  # noqa: F401  (a fixture)

from kempe.errors import MissingExtraError

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"][
    "optional-dependencies"
]

VIEW = """
import sys, warnings
warnings.simplefilter("error", UserWarning)
from pathlib import Path
import kempe
from kempe.description.meshes import read_body_meshes
robot = kempe.load(sys.argv[1])
found, lost = read_body_meshes(robot.mechanism)
assert not lost and sorted(found) == ["a", "b", "c"], (found, lost)
assert all(len(mesh.triangles) == 1 for (mesh,) in found.values())
robot.save_html("page.html")
assert Path("page.html").stat().st_size > 10_000
robot.plot().figure.savefig("robot.png")
print("used")
"""
SYMBOLIC = """
import kempe
X = kempe.load("two_link").symbolic.fk("e")
assert X.shape == (4, 4) and "cos" in str(X[0, 3]), X
print("used")
"""
SCALE = """
import numpy as np, pyarrow, pyarrow.parquet, xarray
import kempe
robot = kempe.load("two_link")
found = robot.workspace("e", n=1000)
found.save("map.zarr")
assert int(xarray.open_zarr("map.zarr", consolidated=False).counts.sum()) > 0
assert len(found.boundary)
q = np.random.default_rng(0).normal(size=(50, robot.nq))
pyarrow.parquet.write_table(pyarrow.table(dict(zip(robot.coordinate_names, q.T))), "q.parquet")
kempe.map_file(robot, "fk", "q.parquet", "poses.zarr", "e")
with xarray.open_zarr("poses.zarr", consolidated=False) as answers:
    np.testing.assert_array_equal(answers.pose, robot.fk(q, "e"))
print("used")
"""
XACRO = """
import kempe
robot = kempe.load("arm.urdf.xacro", xacro=True)
assert robot.joint_names == ("left", "right"), robot.joint_names
print("used")
"""
MJCF = """
import kempe
robot = kempe.load("<mujoco><worldbody><body name='a'><joint name='j'/><geom size='1'/></body></worldbody></mujoco>")
assert robot.joint_names == ("j",), robot.joint_names
print("used")
"""
COLLISION = """
import kempe, sys
robot = kempe.load(sys.argv[1])
assert robot.geometry.clearance(robot.neutral, [("a", "c")]) < 1e-9
print("used")
"""
JIT = """
import numpy as np, kempe
from kempe.kernels import compiled
robot = kempe.load("two_link")
x = robot.fk(robot.neutral, "e")[0, 3]
assert compiled.VARIANT == "jit", compiled.VARIANT
assert abs(x - sum(robot.structure.parameters[n] for n in ("l1", "l2"))) < 1e-12, x
print("used")
"""
DOCUMENTATION = """
import sys
from sphinx.cmd.build import main
assert main(["-q", "-W", "-d", "doctrees", sys.argv[1], "html"]) == 0
print("used")
"""
CODE = {
    "view": VIEW,
    "symbolic": SYMBOLIC,
    "scale": SCALE,
    "xacro": XACRO,
    "mjcf": MJCF,
    "collision": COLLISION,
    "jit": JIT,
    "docs": DOCUMENTATION,
}
"""What each extra is for: code that prints 'used' at its end."""
ELSEWHERE = {
    "test": "a fresh environment with it runs the default suite in .ci/run",
    "wheel": ".ci/run installs it beside, and test_wheel.py builds with it",
    "dev": "it is the union of others with ruff and pyright, which CI runs from it",
    "bench": "it installs other libraries, gigabytes of them, and nothing of Kempe needs it",
}
"""The extras that are not installed here, and why."""

STL = """solid b
facet normal 0 0 1
outer loop
vertex 0 0 0
vertex 1 0 0
vertex 0 1 0
endloop
endfacet
endsolid b
"""
OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
DAE = """<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><created>2020-01-01</created><modified>2020-01-01</modified><unit name="meter" meter="1"/><up_axis>Z_UP</up_axis>
</asset>
<library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="pa" count="9">0 0 0 1 0 0 0 1 0</float_array><technique_common>
<accessor source="#pa" count="3" stride="3"><param name="X" type="float"/><param name="Y" type="float"/>
<param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="1"><input semantic="VERTEX" source="#v" offset="0"/><p>0 1 2</p></triangles>
</mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="s"><node id="n"><instance_geometry url="#g"/></node></visual_scene>
</library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene>
</COLLADA>
"""
ARM = """<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro">
<link name="base"/>
<xacro:macro name="finger" params="side y"><link name="${side}_tip"/>
<joint name="${side}" type="continuous"><parent link="base"/><child link="${side}_tip"/>
<origin xyz="0 ${2 * y} 0"/></joint>
</xacro:macro>
<xacro:finger side="left" y="0.1"/><xacro:finger side="right" y="-0.1"/>
</robot>
"""


def with_meshes(to: Path) -> Path:
    """A robot of three links, each drawn by one triangle, in three formats of meshes."""
    files = {"a.dae": DAE, "b.stl": STL, "c.obj": OBJ}
    links = []
    for name, text in files.items():
        (to / name).write_text(text)
        links.append(
            f'<link name="{name[0]}"><visual><geometry><mesh '
            f'filename="{name}"/></geometry></visual></link>'
        )
    joints = [
        f'<joint name="j{child}" type="continuous"><parent link="{parent}"/><child '
        f'link="{child}"/></joint>'
        for parent, child in ("ab", "bc")
    ]
    path = to / "robot.urdf"
    path.write_text(f'<robot name="r">{"".join(links + joints)}</robot>')
    return path


def installed(to: Path, what: str) -> subprocess.CompletedProcess:
    """What pip says, which installs into a fresh environment below a folder."""
    done([sys.executable, "-m", "venv", "--without-pip", to], to.parent)
    command = [
        sys.executable,
        "-m",
        "pip",
        "--python",
        python_of(to),
        "install",
        "-q",
        "--no-input",
        "--no-compile",
        what,
    ]
    return subprocess.run(
        list(map(str, command)), capture_output=True, text=True, env=environment()
    )


def python_of(env: Path) -> Path:
    return env / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")


@pytest.fixture(scope="module")
def registry() -> None:
    """pip reaches a registry; without one the test is skipped, but fails where CI runs it."""
    command = [
        sys.executable,
        "-m",
        "pip",
        "install",
        "-q",
        "--dry-run",
        "--no-deps",
        "--ignore-installed",
        "sympy",
    ]
    found = subprocess.run(command, capture_output=True, text=True, env=environment())
    if found.returncode:
        said = f"pip reaches no registry: {found.stderr[-300:]}"
        (pytest.fail if os.environ.get("CI") else pytest.skip)(said)


@pytest.fixture(scope="module")
def wheel(folder) -> Path:  # noqa: F811
    """A wheel of the checkout; kernels that are there and fit their sources are taken into it."""

    def built(to: Path) -> None:
        isolation = (
            []
            if find_spec("hatchling") is None or find_spec("numba") is None
            else ["--no-build-isolation"]
        )
        done(
            [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", *isolation, "-w", to, ROOT],
            to,
        )

    (found,) = once(folder / "wheel_with_extras", built).glob("*.whl")
    return found


def test_each_extra_is_used_or_left_out_for_a_reason():
    assert sorted([*CODE, *ELSEWHERE]) == sorted(EXTRAS)


def test_a_missing_package_is_named_in_the_version_of_its_extra(monkeypatch):
    """Several extras may need it, each from another version on."""
    needed = [
        "mujoco>=3.2; extra == 'bench'",
        "mujoco>=3.6; extra == 'mjcf'",
        'viser>=1.1; extra == "view"',
    ]
    monkeypatch.setattr("importlib.metadata.requires", lambda name: needed)
    assert str(MissingExtraError("mujoco", "mjcf")).endswith("pip install 'mujoco>=3.6'")
    assert str(MissingExtraError("viser", "view")).endswith("pip install 'viser>=1.1'")


@pytest.mark.slow
@pytest.mark.parametrize("extra", CODE)
def test_each_extra_alone(extra, registry, wheel, tmp_path):
    said = installed(tmp_path / "env", f"{wheel}[{extra}]")
    assert said.returncode == 0, said.stderr
    arguments: list[str] = []
    if extra == "view":
        arguments = [str(with_meshes(tmp_path))]
    elif extra == "collision":
        path = with_meshes(tmp_path)
        path.write_text(path.read_text().replace("visual", "collision"))
        arguments = [str(path)]
    elif extra == "xacro":
        (tmp_path / "arm.urdf.xacro").write_text(ARM)
    elif extra == "docs":
        arguments = [str(DOCS)]
    env = environment() | ({"KEMPE_KERNELS": "jit"} if extra == "jit" else {})
    command = [str(python_of(tmp_path / "env")), "-c", CODE[extra], *arguments]
    used = subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, text=True)
    assert used.returncode == 0 and used.stdout.endswith("used\n"), f"{used.stdout}\n{used.stderr}"
    if extra == "view":
        assert not used.stderr, "nothing is said of meshes that are not drawn"
