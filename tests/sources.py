"""Sources as syntax trees, each read and parsed once for all tests of style and structure, and
checks of them.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterable
from functools import cache
from itertools import groupby
from pathlib import Path

import pytest

Check = Callable[[Path], None]


@cache
def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


@cache
def nodes(path: Path) -> tuple[ast.AST, ...]:
    """All nodes of a source, in the order of `ast.walk`."""
    return tuple(ast.walk(tree(path)))


def each(paths: Iterable[Path], root: Path) -> Callable[[Check], Callable[[str], None]]:
    """Decorator: the check of one file as a test for each folder, which names all files that fail.

    A test for each of a thousand files would take longer to be counted than to be run.
    """
    folders = {
        folder.relative_to(root).as_posix(): list(files)
        for folder, files in groupby(
            sorted(paths, key=lambda p: (p.parent, p)), key=lambda p: p.parent
        )
    }

    def decorate(check: Check) -> Callable[[str], None]:
        def test(folder: str) -> None:
            failures = {}
            for path in folders[folder]:
                try:
                    check(path)
                except AssertionError as error:
                    failures[path.relative_to(root).as_posix()] = str(error)
            assert not failures, "\n".join(f"{name}: {text}" for name, text in failures.items())

        test.__name__ = check.__name__
        test.__doc__ = check.__doc__
        return pytest.mark.parametrize("folder", folders)(test)

    return decorate
