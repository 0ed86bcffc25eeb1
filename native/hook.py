"""The step of hatchling's build that puts the library of compiled kernels into a wheel, or into a
checkout.
"""

from __future__ import annotations

import platform
import shutil
import sys
import sysconfig
import tempfile
from importlib import metadata
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

sys.path.insert(0, str(Path(__file__).resolve().parent))
import library


class KernelsHook(BuildHookInterface):
    """Builds the library of kernels, a checkout's in place; one that is there and fits its sources
    is taken.
    """

    def dependencies(self) -> list[str]:
        """What the build needs besides what pyproject.toml says: a C compiler, where there is none."""
        return library.requirements()

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Build the library. Errors: `library.BuildError`, whose sentence says what is missing."""
        self.scratch = ""
        if fits := library.is_current():
            self.app.display_info(
                "kernels: the library that is there fits the sources, and is taken"
            )
        if version == "editable":
            if not fits:
                library.build(library.KERNELS)
            return
        built = library.KERNELS / library.library_name() if fits else self._built_apart()
        build_data["force_include"][str(built)] = f"kempe/kernels/{built.name}"
        build_data["force_include"][str(_licence_of_numba())] = "kempe/kernels/LICENSE.numba"
        build_data["force_include"][str(Path(self.root, "docs", "lecture.md"))] = (
            "kempe/library/lecture.md"  # the tour
        )
        build_data["pure_python"] = False
        build_data["tag"] = f"cp311-abi3-{_platform_tag()}"

    def _built_apart(self) -> Path:
        self.scratch = tempfile.mkdtemp(prefix="kempe-")
        try:
            return library.build(Path(self.scratch))
        except library.BuildError:
            shutil.rmtree(self.scratch)
            raise

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove what the wheel now holds."""
        if self.scratch:
            shutil.rmtree(self.scratch)


def _licence_of_numba() -> Path:
    """The licence of the compiler, parts of whose runtime library are in the compiled kernels."""
    for file in metadata.files("numba") or ():
        if file.name == "LICENSE":
            return Path(str(file.locate()))
    raise library.BuildError(
        "the package numba came without its file LICENSE, which a wheel must hold"
    )


def _platform_tag() -> str:
    if sys.platform == "linux" and library.is_release():
        return f"manylinux_{library.GLIBC.replace('.', '_')}_{platform.machine()}"
    if sys.platform == "darwin":  # a universal Python would claim two processors
        return f"macosx_{library.MACOS.replace('.', '_')}_{platform.machine()}"
    return sysconfig.get_platform().replace("-", "_").replace(".", "_")
