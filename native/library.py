"""Build the library of compiled kernels: `python native/library.py [FOLDER]`, by default where it
is looked for.

Kernels are compiled by Numba, once for each variant, in two processes at a time (emit.py); the C
layer is written from their declarations (layer.py), and a C compiler makes one library of all of
it, for the stable ABI of Python 3.11.

The environment variable KEMPE_BUILD says for which processors: nothing for this one, "release" for
all of this platform, or names of variants ("v2,v3"). CC names a C compiler; without one the package
ziglang serves.
"""

from __future__ import annotations

import ast
import hashlib
import json
import os
import platform
import shlex
import shutil
import signal
import subprocess
import sys
import sysconfig
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

HERE = Path(__file__).resolve().parent
KERNELS = HERE.parent / "src" / "kempe" / "kernels"
VARIABLE = "KEMPE_BUILD"
RELEASE = "release"
PROCESSES = 2
GLIBC = "2.17"
"""The oldest C library of Linux on which a released library runs."""

MACOS = "11.0"
"""The oldest macOS on which the library runs."""

WINDOWS = "x86_64-w64-windows-gnu"
"""The kind of Windows that objects are made for, which is the one that Zig links."""


class Variant(NamedTuple):
    """A family of processors: LLVM's name and settings, what is found by, and the level that
    layer.c looks for.
    """

    cpu: str
    settings: str
    features: str
    level: int


X86 = {
    "v4": Variant(
        "x86-64-v4", "+avx512f,-prefer-256-bit", "avx512f avx512bw avx512cd avx512dq avx512vl", 4
    ),
    "v3": Variant("x86-64-v3", "", "avx2 bmi bmi2 f16c fma lzcnt movbe", 3),
    "v2": Variant("x86-64-v2", "", "cx16 popcnt sse4.2", 2),
}
"""Variants, the best first."""
OTHERS = {"base": Variant("apple-m1" if sys.platform == "darwin" else "generic", "", "", 1)}


class BuildError(Exception):
    """What keeps the library from being built, in a sentence."""


def variants() -> dict[str, Variant]:
    """The variants of this platform."""
    machine = platform.machine().lower()
    if machine in ("x86_64", "amd64"):
        return X86
    if machine in ("arm64", "aarch64"):
        return OTHERS
    raise BuildError(f"kernels are compiled for x86-64 and arm64, not for {platform.machine()}")


def is_release() -> bool:
    """Whether the library is for all processors of the platform, and on Linux for old systems."""
    return os.environ.get(VARIABLE) == RELEASE


def requested() -> list[str]:
    """The variants to build, the best first."""
    known = variants()
    value = os.environ.get(VARIABLE, "")
    if is_release():
        return list(known)
    if value:
        names = [name.strip() for name in value.split(",")]
        if not set(names) <= set(known):
            raise BuildError(
                f"{VARIABLE} is {value!r}; allowed: 'release', or names among {', '.join(known)}"
            )
        return [name for name in known if name in names]
    import llvmlite.binding as llvm

    has = llvm.get_host_cpu_features()
    for name, variant in known.items():
        if all(has.get(feature, False) for feature in variant.features.split()):
            return [name]
    raise BuildError("this processor is older than x86-64-v2 (SSE 4.2), which kernels need")


# ----------------------------------------------------------------------------------------------
# what is compiled


def _file(name: str) -> Path:
    """The source of a module of kernels, named from the package on: `base.vectors`."""
    return KERNELS / f"{name.replace('.', '/')}.py"


def _source(name: str) -> str:
    return _file(name).read_text()


@cache
def needed(name: str) -> frozenset[str]:
    """A module of kernels and all modules of kernels that it imports."""
    found = set[str]()
    queue = [name]
    while queue:
        module = queue.pop()
        if module in found or not _file(module).is_file():
            continue
        found.add(module)
        for node in ast.walk(ast.parse(_source(module))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("kempe.kernels"):
                inside = (node.module or "").removeprefix("kempe.kernels").removeprefix(".")
                queue += [
                    inside,
                    *(f"{inside}.{alias.name}".removeprefix(".") for alias in node.names),
                ]
    return frozenset(found)


def shares() -> list[list[str]]:
    """The modules that have kernels, one list a process: what shares helpers together, and about
    equally long.
    """
    paths = [path for path in sorted(KERNELS.rglob("*.py")) if "\n@kernel(" in path.read_text()]
    modules = [".".join(path.relative_to(KERNELS).with_suffix("").parts) for path in paths]
    lines = {name: len(_source(name).splitlines()) for module in modules for name in needed(module)}
    lists: list[list[str]] = [[] for _ in range(PROCESSES)]
    together: list[frozenset[str]] = [frozenset()] * PROCESSES

    def length(k: int, name: str) -> int:
        return sum(lines[m] for m in together[k] | needed(name))

    for name in sorted(modules, key=lambda name: (-sum(lines[m] for m in needed(name)), name)):
        k = min(range(PROCESSES), key=lambda k: length(k, name))
        lists[k].append(name)
        together[k] |= needed(name)
    return lists


def emit(
    variant: str, modules: list[str], out: Path, running: list[subprocess.Popen]
) -> dict[str, Any]:
    """The object of one process, and what is known of its kernels."""
    cpu, settings, *_ = variants()[variant]
    env = {k: v for k, v in os.environ.items() if not k.startswith(("NUMBA_", "KEMPE_"))}
    env |= {"NUMBA_CPU_NAME": cpu, "NUMBA_CPU_FEATURES": settings, "PYTHONHASHSEED": "0"}
    command = [sys.executable, str(HERE / "emit.py"), variant, str(out), *modules]
    with out.with_suffix(".log").open("w+") as log:
        process = subprocess.Popen(
            command, env=env, stdin=subprocess.PIPE, stdout=log, stderr=log, text=True
        )
        running.append(process)
        with process:
            code = process.wait()
        log.seek(0)
        if code:
            raise BuildError(f"compiling {', '.join(modules)} failed:\n{log.read().strip()}")
    return json.loads(out.with_suffix(".json").read_text())


# ---------------------------------------------------------------------------------------------- the
# C compiler


def _zig() -> list[str]:
    target = ["-target", WINDOWS.replace("w64-", "")] if sys.platform == "win32" else []
    return [sys.executable, "-m", "ziglang", "cc", *target]


def compiler() -> list[str]:
    """The command of a C compiler: the system's; for what is released on Linux, or where there is
    none, Zig's.
    """
    if sys.platform == "linux" and is_release():
        return [*_zig(), "-target", f"{platform.machine()}-linux-gnu.{GLIBC}"]
    if sys.platform != "win32":  # there it would be a compiler with another command line
        given = shlex.split(os.environ.get("CC", ""))
        if given:
            return given
        for name in ("cc", "gcc", "clang"):
            if shutil.which(name):
                return [name]
    return _zig()


def requirements() -> list[str]:
    """What the build needs besides what pyproject.toml says."""
    return ["ziglang>=0.13"] if "ziglang" in compiler() else []


def headers() -> Path:
    """The folder of Python's headers. Errors: `BuildError` where these or a compiler are missing."""
    program, *_ = command = compiler()
    if "ziglang" in command and find_spec("ziglang") is None:
        raise BuildError(
            "there is no C compiler: install one, or the package ziglang (pip install ziglang)"
        )
    if shutil.which(program) is None:
        raise BuildError(f"there is no program {program!r}, which CC names as the C compiler")
    include = Path(sysconfig.get_path("include"))
    if not (include / "Python.h").is_file():
        raise BuildError(
            f"{include} has no Python.h: the headers of Python are missing (Debian and Ubuntu have "
            "them in python3-dev)"
        )
    return include


def _link(sources: list[Path], out: Path) -> None:
    import numpy

    command = [
        *compiler(),
        "-O2",
        "-shared",
        "-fvisibility=hidden",
        "-I",
        str(headers()),
        "-I",
        numpy.get_include(),
    ]
    command += [str(path) for path in sources]
    if sys.platform == "win32":
        command += ["-L", str(Path(sys.base_prefix) / "libs"), "-lpython3"]
    elif sys.platform == "darwin":
        command += [
            "-fPIC",
            "-lm",
            f"-mmacosx-version-min={MACOS}",
            "-Wl,-undefined,dynamic_lookup",
            "-Wl,-x",
        ]
    else:
        command += ["-fPIC", "-lm", "-Wl,--gc-sections", "-Wl,-z,now", "-s"]
    caches = {
        name: str(out.parent / "zig") for name in ("ZIG_GLOBAL_CACHE_DIR", "ZIG_LOCAL_CACHE_DIR")
    }
    done = subprocess.run(
        [*command, "-o", str(out)], capture_output=True, text=True, env={**caches, **os.environ}
    )
    if done.returncode:
        raise BuildError(f"{' '.join(command[:3])} ... failed:\n{done.stderr.strip()}")


# ---------------------------------------------------------------------------------------------- all
# of it


def library_name() -> str:
    """The file name of the library."""
    return "_native.pyd" if sys.platform == "win32" else "_native.abi3.so"


def sources() -> str:
    """Digests of the sources of all kernels, as the package computes them."""
    sys.path.insert(0, str(HERE.parent / "src"))
    try:
        from kempe.kernels.digest import compute_source_digests
    finally:
        sys.path.pop(0)
    return compute_source_digests(KERNELS)


def is_current() -> bool:
    """Whether the checkout has a library of its sources, by this builder, for what is required;
    none for a release.
    """
    if is_release():
        return False
    code = (
        "from kempe.kernels import _native as n; print(n.BUILDER, *n.VARIANTS); print(n.SOURCES, "
        "end='')"
    )
    paths = [str(HERE.parent / "src"), *filter(None, [os.environ.get("PYTHONPATH")])]
    env = os.environ | {"PYTHONPATH": os.pathsep.join(paths)}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=env)
    return (
        done.returncode == 0
        and done.stdout == f"{' '.join([builder(), *requested()])}\n{sources()}"
    )


def builder() -> str:
    """Digest of the sources of this builder."""
    found = hashlib.sha256()
    for path in sorted([*HERE.glob("*.py"), *HERE.glob("*.c")]):
        found.update(path.read_bytes())
    return found.hexdigest()


def say(text: str) -> None:
    """Print a line at once: a build takes a while."""
    print(text, flush=True)


def build(folder: Path) -> Path:
    """The library, written to `folder`. Errors: `BuildError`."""
    if platform.python_implementation() != "CPython" or sysconfig.get_config_var("Py_GIL_DISABLED"):
        raise BuildError(
            "the library needs CPython with its stable ABI: not PyPy, not yet a free-threaded build"
        )
    start = time.perf_counter()
    names = requested()
    before = sources()
    headers()
    say(f"kernels: compiling for {', '.join(names)} in {PROCESSES} processes ...")
    with tempfile.TemporaryDirectory() as scratch:
        linked, kernels = compiled(names, Path(scratch), before)
        for row in kernels:
            say(f"  {row['label']:38}{row['seconds']:6.1f} s {row['bytes']:8} bytes")
        if sources() != before:
            raise BuildError(
                "the sources of the kernels changed while they were compiled; build again"
            )
        size = linked.stat().st_size
        spent = time.perf_counter() - start
        folder.mkdir(parents=True, exist_ok=True)
        fresh = folder / f"{library_name()}.{os.getpid()}"
        try:
            shutil.copyfile(linked, fresh)
            # a process that has the old one open keeps it
            os.replace(fresh, folder / library_name())
        finally:
            fresh.unlink(missing_ok=True)
    say(f"kernels: {len(kernels)} in {size / 1e6:.2f} MB, {spent:.0f} s")
    return folder / library_name()


def compiled(names: list[str], work: Path, sources: str) -> tuple[Path, list[dict[str, Any]]]:
    """The library in a scratch folder, and what is known of its kernels."""
    from layer import source

    running: list[subprocess.Popen] = []
    jobs = [(v, share, work / f"{v}-{k}.o") for v in names for k, share in enumerate(shares())]
    with ThreadPoolExecutor(PROCESSES) as pool:
        try:
            reports = list(pool.map(lambda job: emit(*job, running), jobs))
        except BaseException:  # an interrupt, too: the others would go on for half a minute
            pool.shutdown(wait=False, cancel_futures=True)
            for process in running:
                process.kill()
            raise
    first = [
        report["kernels"] for job, report in zip(jobs, reports, strict=True) if job[0] == names[0]
    ]
    kernels = sorted(sum(first, []), key=lambda row: row["name"])
    levels = {name: variants()[name].level for name in names}
    (work / "native.c").write_text(source(kernels, levels, sources, builder()))
    linked = work / library_name()
    _link([work / "native.c", *(job[2] for job in jobs)], linked)
    return linked, kernels


def main() -> None:
    """Build, from the command line."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    sys.path.insert(0, str(HERE))
    try:
        build(Path(sys.argv[1]) if len(sys.argv) > 1 else KERNELS)
    except BuildError as error:
        sys.exit(f"kernels: {error}")
    except KeyboardInterrupt:
        sys.exit("kernels: interrupted; the library is as it was")


if __name__ == "__main__":
    main()
