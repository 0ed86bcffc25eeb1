"""Copies of the package in which tests may edit kernels, and processes that use them."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
BLOCKED = "import sys; sys.modules.update(numba=None, llvmlite=None)\n"
"""Makes Numba impossible to import."""


def copied(to: Path) -> Path:
    """A copy of the package, its library and its builder below a folder; returns the folder of the
    package.
    """
    leave = shutil.ignore_patterns("__pycache__")
    shutil.copytree(ROOT / "native", to / "native", ignore=leave)
    return Path(shutil.copytree(ROOT / "src" / "kempe", to / "src" / "kempe", ignore=leave))


def run(code: str, package: Path | None = None, **environment: str) -> subprocess.CompletedProcess:
    """A fresh interpreter that runs `code`, with the package of a copy where one is given."""
    env = {
        name: value for name, value in os.environ.items() if not name.startswith("KEMPE_")
    } | environment
    if package is not None:
        env["PYTHONPATH"] = str(package.parent)
    return subprocess.run(
        [sys.executable, "-c", code], env=env, capture_output=True, text=True, timeout=300
    )


def printed(code: str, package: Path | None = None, **environment: str) -> str:
    """What such an interpreter prints, that ends well and says nothing else."""
    done = run(code, package, **environment)
    assert done.returncode == 0 and not done.stderr, done.stderr
    return done.stdout.strip()


def once(folder: Path, make: Callable[[Path], object]) -> Path:
    """The folder, filled by the first of the processes that ask for it; the others wait."""
    done = folder.with_name(f"{folder.name}.done")
    try:
        folder.mkdir()
    except FileExistsError:
        while not done.exists():
            time.sleep(0.5)
        return folder
    try:
        make(folder)
    finally:
        done.touch()
    return folder


def of_all_processes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of all processes of this run of the tests."""
    base = tmp_path_factory.getbasetemp()
    return base.parent if os.environ.get("PYTEST_XDIST_WORKER") else base
