"""The compiler's wrapper: nothing stale, nothing compiled twice, works where nothing can be written."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numba
import numpy as np
import pytest

from kempe.kernels import _jit

CALLER = """
from numba import types
from mini._jit import F1, kernel, routine
from mini.callee import double, twice

@routine
def four_times(x):
    return twice(twice(x))

@kernel(types.float64(F1))
def total(x):
    return double(x[0])

@kernel(types.float64(F1))
def fourfold(x):
    return four_times(x[0])
"""
CALLEE = """
from mini._jit import device, routine

@device
def double(x):
    return {factor} * x

@routine
def twice(x):
    return double(x)
"""
MAIN = """
import numpy as np
from mini import caller, _jit
print(caller.total(np.ones(1)), caller.fourfold(np.ones(1)), dict(_jit.compiled), _jit.cache_folder() is not None)
"""


@pytest.fixture
def mini(tmp_path):
    """A package with the wrapper, two kernels and their helpers in two files; call it to run it in a new process."""
    package = tmp_path / "mini"
    package.mkdir()
    shutil.copy(Path(_jit.__file__), package / "_jit.py")
    (package / "__init__.py").write_text("")
    (package / "caller.py").write_text(CALLER)

    def run(factor=2, **environment):
        (package / "callee.py").write_text(CALLEE.format(factor=factor))
        path = os.pathsep.join([str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])])
        settings = {"KEMPE_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": path, **environment}
        done = subprocess.run(
            [sys.executable, "-B", "-c", MAIN],
            env={**os.environ, **settings}, capture_output=True, text=True, timeout=120,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        return done.stdout.strip()

    return run


def test_second_process_loads_and_an_edited_callee_recompiles(mini):
    assert mini() == "2.0 4.0 {'total': 1, 'fourfold': 1} True"
    assert mini() == "2.0 4.0 {} True"
    assert mini(factor=3) == "3.0 9.0 {'total': 1, 'fourfold': 1} True"
    assert mini(factor=2) == "2.0 4.0 {} True"


def test_without_a_writable_folder_it_compiles_in_memory(mini):
    assert mini(KEMPE_CACHE_DIR="/proc/nowhere") == "2.0 4.0 {'total': 1, 'fourfold': 1} False"


def test_no_home_makes_no_folder_called_tilde(monkeypatch):
    monkeypatch.delenv("KEMPE_CACHE_DIR", raising=False)
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(os.path, "expanduser", lambda path: path)
    assert all(folder.is_absolute() for folder in _jit._folders())


def test_every_kernel_has_one_signature_and_read_only_inputs_take_writable_arrays():
    from kempe.kernels import bound, chain, solve, sweep

    kernels = {
        f"{module.__name__}.{name}": thing
        for module in (bound, chain, solve, sweep)
        for name, thing in vars(module).items()
        if isinstance(thing, numba.core.dispatcher.Dispatcher) and thing._can_compile is False
    }
    assert len(kernels) >= 8
    assert {name: len(k.signatures) for name, k in kernels.items()} == dict.fromkeys(kernels, 1)
    ints = np.zeros(10, dtype=np.int64)
    ints[1], ints[8] = 1, -1
    table, out = bound.fuse(ints, np.eye(3, 4).ravel()), np.empty((4, 4))
    for writeable in (True, False):
        table.setflags(write=writeable)
        assert bound.pose(table, np.empty(0), out) == 0
        assert np.array_equal(out, np.eye(4))
    assert len(bound.pose.signatures) == 1


def test_two_threads_may_be_first(tmp_path):
    code = (
        "import threading, numpy as np, kempe\n"
        "m = kempe.Mechanism('m'); m.revolute('j', m.ground, m.body('b')); s = m.build(); out = []\n"
        "ts = [threading.Thread(target=lambda: out.append(s.fk([0.5], 'b'))) for _ in range(4)]\n"
        "[t.start() for t in ts]; [t.join() for t in ts]\n"
        "assert len(out) == 4 and all(np.array_equal(out[0], o) for o in out)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr


def test_a_filled_folder_that_cannot_be_written_is_used(tmp_path, monkeypatch):
    filled = tmp_path / _jit.source_digest()
    (filled / "sub").mkdir(parents=True)
    (filled / "sub" / "kernel.nbi").write_text("compiled")
    temporary = _jit.tempfile.TemporaryFile

    def refuse(dir=None):
        if Path(dir).is_relative_to(tmp_path):
            raise PermissionError(dir)
        return temporary(dir=dir)

    monkeypatch.setattr(_jit, "_folders", lambda: [tmp_path])
    monkeypatch.setattr(_jit.tempfile, "TemporaryFile", refuse)
    folder = _jit.cache_folder.__wrapped__()
    assert folder is not None and folder != filled
    assert (folder / "sub" / "kernel.nbi").read_text() == "compiled"
