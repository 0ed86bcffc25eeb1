"""The builder: what it cannot carry it refuses with a sentence; its processes share the work, all
of it.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys

import pytest
from copies import ROOT, copied
from hunts import some

from kempe.kernels import compiled

sys.path.insert(0, str(ROOT / "native"))
import layer
import library

HEAD = """
import numpy as np
from kempe.kernels.base._jit import kernel
from kempe.kernels.base.declare import INT, OUT, F
"""
BAD = {
    "a call into the runtime of Python": (
        "@kernel(F('n'))\ndef bad(x):\n    print(x[0])\n    return 0\n",
        "bad__bad refers to an object of this process|kernels call what they do not bring",
    ),
    "the address of an object": (
        "import ctypes\nnoise = ctypes.CFUNCTYPE(ctypes.c_double)(lambda: 1.0)\n"
        "@kernel(F('n'))\ndef bad(x):\n    return int(noise())\n",
        "bad__bad refers to an object of this process by its address",
    ),
    "another number of arguments": (
        "@kernel(F('n'), INT)\ndef bad(x):\n    return 0\n",
        "bad__bad declares 2 arguments, but has 1",
    ),
}


def emitted(folder, source: str) -> subprocess.CompletedProcess:
    package = copied(folder)
    (package / "kernels" / "bad.py").write_text(HEAD + source)
    env = os.environ | {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""}
    command = [
        sys.executable,
        str(folder / "native" / "emit.py"),
        "base",
        str(folder / "bad.o"),
        "bad",
    ]
    return subprocess.run(command, env=env, capture_output=True, text=True)


@pytest.mark.slow
@pytest.mark.parametrize("what", some(BAD, 3))
def test_what_cannot_be_carried_is_refused(tmp_path, what):
    source, said = BAD[what]
    done = emitted(tmp_path, source)
    assert done.returncode != 0 and not (tmp_path / "bad.o").exists()
    assert re.search(said, done.stderr), done.stderr


@pytest.mark.slow
def test_a_good_kernel_is_emitted_with_its_declaration(tmp_path):
    done = emitted(
        tmp_path, "@kernel(F('n'), OUT('n'))\ndef bad(x, y):\n    y[0] = 2.0 * x[0]\n    return 7\n"
    )
    assert done.returncode == 0 and not done.stderr, done.stderr
    assert (tmp_path / "bad.o").stat().st_size > 0 and '"bad__bad"' in (
        tmp_path / "bad.json"
    ).read_text()


@pytest.mark.slow
def test_two_objects_are_the_same_byte_by_byte(tmp_path, monkeypatch):
    """In two folders, in two processes of the builder; test_wheel.py compares whole wheels."""
    made = []
    for name in ("one", "two"):
        copied(tmp_path / name)
        monkeypatch.setattr(library, "HERE", tmp_path / name / "native")
        library.emit(
            min(library.variants()),
            ["forward.chain", "closed_form.candidates"],
            tmp_path / f"{name}.o",
            [],
        )
        made.append((tmp_path / f"{name}.o").read_bytes())
    assert made[0] == made[1] and len(made[0]) > 10_000


@pytest.mark.slow
def test_the_processes_share_all_modules_with_kernels_about_evenly():
    shares = library.shares()
    modules = [
        path.stem for path in library.KERNELS.rglob("*.py") if "@kernel(" in path.read_text()
    ]
    shared = [name.rpartition(".")[2] for share in shares for name in share]
    assert (
        sorted(shared) == sorted(set(modules) - {"_jit", "declare"}) and shares == library.shares()
    )
    lines = [len(frozenset().union(*map(library.needed, share))) for share in shares]
    assert max(lines) <= 2 * min(lines)


def test_a_length_that_nothing_gives_is_refused():
    takes = [{"entry": "f", "shape": ["n+1"], "written": False}]
    with pytest.raises(ValueError, match=r"length 'n\+1', but no axis has the length 'n'"):
        list(layer.lengths(takes, [0]))


def test_a_compiler_is_required_only_where_there_is_none(monkeypatch, tmp_path):
    for name in ("CC", "KEMPE_BUILD"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert library.requirements() == ["ziglang>=0.13"]
    (tmp_path / "cc").write_text("#!/bin/sh\n")
    (tmp_path / "cc").chmod(0o755)
    assert library.compiler() == ["cc"] and library.requirements() == []
    monkeypatch.setenv("CC", "my-cc --fast")
    assert library.compiler() == ["my-cc", "--fast"]


def test_wishes_are_checked(monkeypatch):
    known = library.variants()
    monkeypatch.setenv("KEMPE_BUILD", "release")
    assert library.requested() == list(known)
    monkeypatch.setenv("KEMPE_BUILD", ", ".join(reversed(known)))
    assert library.requested() == list(known)
    monkeypatch.delenv("KEMPE_BUILD")
    assert len(library.requested()) == 1
    monkeypatch.setenv("KEMPE_BUILD", "v7")
    with pytest.raises(
        library.BuildError, match="KEMPE_BUILD is 'v7'; allowed: 'release', or names among"
    ):
        library.requested()


def test_a_library_that_fits_is_kept(monkeypatch):
    """Also where the packages that it needs come by PYTHONPATH, as in an isolated build."""
    monkeypatch.delenv("KEMPE_BUILD", raising=False)
    assert library.is_current()
    monkeypatch.setattr(library, "builder", lambda: "another builder")
    assert not library.is_current()


def test_no_library_that_is_there_is_released(monkeypatch):
    """It may have been linked for later systems only."""
    monkeypatch.setenv("KEMPE_BUILD", "release")
    assert not library.is_current()


def test_the_processor_is_recognised_as_llvm_does():
    """The levels that layer.c finds by asking the processor, against the features that LLVM finds."""
    import llvmlite.binding as llvm

    has = llvm.get_host_cpu_features()
    for name, runs in getattr(compiled._native, "VARIANTS", {}).items():
        assert runs == all(has[feature] for feature in library.variants()[name].features.split())


def test_other_processors_are_refused_by_name(monkeypatch):
    monkeypatch.setattr(library.platform, "machine", lambda: "riscv64")
    with pytest.raises(library.BuildError, match="not for riscv64"):
        library.variants()


def test_without_headers_the_build_says_where_they_are(monkeypatch, tmp_path):
    monkeypatch.setattr(library.sysconfig, "get_path", lambda name: str(tmp_path))
    with pytest.raises(library.BuildError, match="python3-dev"):
        library.headers()


def test_a_compiler_that_is_not_there_is_named_before_anything_is_compiled(monkeypatch):
    monkeypatch.delenv("KEMPE_BUILD", raising=False)
    monkeypatch.setenv("CC", "'/no such/cc' -O1")
    with pytest.raises(library.BuildError, match="no program '/no such/cc', which CC names"):
        library.headers()


def test_a_compiler_that_fails_is_quoted(monkeypatch, tmp_path):
    (tmp_path / "broken").write_text("#!/bin/sh\necho 'cannot do that' >&2\nexit 3\n")
    (tmp_path / "broken").chmod(0o755)
    monkeypatch.setenv("CC", str(tmp_path / "broken"))
    monkeypatch.delenv("KEMPE_BUILD", raising=False)
    with pytest.raises(library.BuildError, match="cannot do that"):
        library._link([], tmp_path / "out.so")
