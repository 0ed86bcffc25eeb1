"""A released wheel: built without compiler and network, for old systems, the same twice, right in
each variant.
"""

from __future__ import annotations

import hashlib
import os
import platform
import re
import shutil
import subprocess
import sys
import zipfile
from importlib.util import find_spec
from pathlib import Path

import hunts
import numpy as np
import pytest
from copies import of_all_processes, once

from kempe.kernels.digest import compute_source_digests

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        sys.platform != "linux", reason="what is released elsewhere is linked by other tools"
    ),
    pytest.mark.skipif(find_spec("ziglang") is None, reason="needs the extra 'wheel'"),
]
ROOT = Path(__file__).parents[1]
VARIANTS = ("v4", "v3", "v2") if platform.machine() == "x86_64" else ("base",)


def built(to: Path) -> Path:
    """A released wheel, built from a copy of the sources by what is installed, with no other
    program to be found.
    """
    source = to / "source"
    leave = shutil.ignore_patterns("__pycache__", ".*", "_native*", "dist", "build", "_build")
    shutil.copytree(ROOT, source, ignore=leave)
    (to / "nothing").mkdir()
    env = {
        name: value for name, value in os.environ.items() if not name.startswith(("KEMPE_", "CC"))
    }
    command = [
        sys.executable,
        "-m",
        "pip",
        "wheel",
        "-v",
        "--no-deps",
        "--no-build-isolation",
        "--no-index",
        "-w",
        to,
    ]
    done = subprocess.run(
        [*map(str, command), str(source)],
        capture_output=True,
        text=True,
        env=env
        | {
            "PATH": str(to / "nothing"),
            "KEMPE_BUILD": "release",
            "PIP_DISABLE_PIP_VERSION_CHECK": "1",
        },
    )
    assert done.returncode == 0, done.stdout + done.stderr
    said = re.findall(r"^ +(\S+) +[\d.]+ s +\d+ bytes$", done.stdout + done.stderr, re.MULTILINE)
    assert len(said) >= 20 and "table_sweep.compute_poses" in said, (
        "a build says what it compiles, how long, how large"
    )
    (wheel,) = to.glob("*.whl")
    return wheel


@pytest.fixture(scope="session")
def shared(tmp_path_factory) -> Path:
    return of_all_processes(tmp_path_factory)


@pytest.fixture(scope="session")
def wheel(shared) -> Path:
    (found,) = once(shared / "wheel", built).glob("*.whl")
    return found


@pytest.fixture(scope="session")
def fresh(shared, wheel) -> Path:
    """The interpreter of an environment with the wheel, and with the packages that it needs but
    without Numba.
    """

    def make(folder: Path) -> None:
        subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder], check=True)
        (site,) = folder.glob("lib/python*/site-packages")
        python = folder / "bin" / "python"
        install = [
            sys.executable,
            "-m",
            "pip",
            "--python",
            python,
            "install",
            "-q",
            "--no-deps",
            "--no-index",
            wheel,
        ]
        subprocess.run(install, check=True, env=os.environ | {"PIP_DISABLE_PIP_VERSION_CHECK": "1"})
        (site / "others.pth").write_text(str(Path(np.__file__).parents[1]))
        (site / "blocked.pth").write_text(
            "import sys; sys.modules.update(numba=None, llvmlite=None)\n"
        )

    return once(shared / "fresh", make) / "bin" / "python"


def run(python: Path, code: str, *arguments: object, **environment: str) -> str:
    env = {
        name: value
        for name, value in os.environ.items()
        if not name.startswith(("KEMPE_", "PYTHON"))
    }
    done = subprocess.run(
        [str(python), "-c", code, *map(str, arguments)],
        env=env | environment,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_what_is_in_it(wheel):
    assert wheel.name.endswith(f"-cp311-abi3-manylinux_2_17_{platform.machine()}.whl")
    assert wheel.stat().st_size < 3.7e6
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        (metadata,) = (archive.read(n).decode() for n in names if n.endswith("/METADATA"))
        licence = archive.read("kempe/kernels/LICENSE.numba").decode()
    assert [n for n in names if n.endswith((".so", ".o", ".c"))] == [
        "kempe/kernels/_native.abi3.so"
    ]
    assert "Anaconda" in licence and "Redistribution" in licence
    assert "kempe/library/lecture.md" in names, "the tour walks through it"
    needs = re.findall(r"^Requires-Dist: ([\w-]+)[^;\n]*$", metadata, re.MULTILINE)
    assert sorted(needs) == ["numpy", "rich", "scipy", "typer"]


def test_it_runs_on_old_systems_and_on_later_pythons(wheel):
    """As the tools of the field audit it: the symbols of the C library, and those of the stable
    ABI.
    """
    shown = run(
        Path(sys.executable),
        "import sys; from auditwheel.main import main; sys.exit(main())",
        "show",
        wheel,
    )
    assert f"manylinux_2_17_{platform.machine()}" in " ".join(shown.split())
    audit = [sys.executable, "-m", "abi3audit", "--strict", "--report", str(wheel)]
    done = subprocess.run(audit, capture_output=True, text=True)
    assert done.returncode == 0 and '"is_abi3": true' in done.stdout, done.stdout + done.stderr


@pytest.mark.skipif(hunts.TIMES < 1, reason="takes minutes: runs with --hunt-times 1")
def test_two_builds_are_the_same_byte_by_byte(wheel, tmp_path):
    again = built(tmp_path)
    assert (
        hashlib.sha256(again.read_bytes()).digest() == hashlib.sha256(wheel.read_bytes()).digest()
    )


def test_an_environment_without_numba_runs_it(fresh):
    code = (
        "import kempe, kempe.kernels.compiled as c\n"
        "print(kempe.__file__, *c._native.VARIANTS); print(c._native.SOURCES)"
    )
    first, _, sources = run(fresh, code).partition("\n")
    file, *variants = first.split()
    assert (
        str(fresh.parent.parent) in file
        and sources == compute_source_digests().strip()
        and tuple(variants) == VARIANTS
    )
    for arguments, shown in (
        (
            ("ik", "puma560", "--frame", "tool", "--target", "0.5,0.2,0.1,0,90,0", "--deg"),
            r"reached(.|\n)*37\.9802",
        ),
        (("--version",), rf"kernels ({'|'.join(VARIANTS)})"),
    ):
        command = [str(fresh.parent / "kempe"), *arguments]
        assert re.search(
            shown, subprocess.run(command, capture_output=True, text=True, check=True).stdout
        )


ANSWERS = """
import sys, numpy as np, kempe
out = {}
for name in ("panda", "puma560", "ur5", "jaco2", "stanford", "youbot"):
    robot = kempe.load(name)
    frame = robot.frame_names[-1]
    q = robot.random(1, 200)
    X = out[f"{name} pose"] = robot.fk(q, frame)
    out[f"{name} bodies"] = robot.fk(q)
    out[f"{name} jacobian"] = robot.jacobian(q, frame)
    s = robot.ik(X, frame, start=q + 1e-3)
    out[f"{name} ik"], out[f"{name} ik pose"] = s.success, robot.fk(s.q, frame)
    a = robot.ik_all(X[:50], frame)
    out[f"{name} all"] = a.mask.sum(axis=-1)
    rows = np.where(a.mask[..., None], a.q, np.inf)
    order = np.argsort(np.round(rows[..., :1], 6)[..., 0] + 1e-3 * np.round(rows[..., 1], 6), axis=1, kind="stable")
    out[f"{name} all q"] = np.take_along_axis(rows, order[..., None], axis=1)
for name in ("four_bar", "jansen", "stewart", "bennett", "delta_uu", "andrews_squeezer"):
    system = kempe.load(name)
    q0 = system.q("closed") if "closed" in system.structure.posture_names else system.neutral
    s = system.assemble({}, start=q0)
    out[f"{name} closed"], out[f"{name} residual"] = s.q, np.array(s.residual)
    out[f"{name} dof"] = np.array(system.mobility(s.q).dof)
np.savez(sys.argv[1], **out)
"""


def test_each_variant_against_each(fresh, tmp_path):
    """Differences are those of rounding: fused multiplications, and the order of sums in
    eliminations.
    """
    runs = run(
        fresh,
        "import kempe.kernels.compiled as c; print(*[v for v, ok in c._native.VARIANTS.items() if "
        "ok])",
    )
    found = {}
    for variant in runs.split():
        run(fresh, ANSWERS, tmp_path / f"{variant}.npz", KEMPE_KERNELS=variant)
        found[variant] = np.load(tmp_path / f"{variant}.npz")
    first = found[runs.split()[0]]
    for variant, answers in found.items():
        for name in first.files:
            a = first[name]
            b = answers[name]
            bound = (
                1e-14 if name.split()[-1] in ("pose", "bodies", "jacobian", "residual") else 1e-11
            )
            bound = bound if a.dtype == float else 0.0
            np.testing.assert_allclose(
                b, a, rtol=0, atol=bound, equal_nan=True, err_msg=f"{variant}: {name}"
            )


def test_a_variant_that_it_lacks_is_refused(fresh):
    with pytest.raises(
        AssertionError, match="KEMPE_KERNELS is 'v9', but this library does not have it"
    ):
        run(fresh, "import kempe.kernels.compiled", KEMPE_KERNELS="v9")
