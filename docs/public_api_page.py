"""Writes docs/public_api.txt, every public name with its signature:
`python docs/public_api_page.py`.

Public are the names in `kempe.__all__`, those of the modules among them, and the members of the
classes among them and of the answers and namespaces that their methods are annotated to return.
"""

from __future__ import annotations

import ast
import enum
import importlib
import inspect
import re
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import kempe

OUT = Path(__file__).with_name("public_api.txt")


def signature(name: str, thing: Any) -> str:
    """A line with a name and its signature, or with what it is."""
    if isinstance(thing, property) or hasattr(thing, "attrname"):  # of functools.cached_property
        function = thing.fget if isinstance(thing, property) else thing.func
        return f"{name}: {inspect.signature(function).return_annotation}"
    if inspect.isclass(thing) and issubclass(thing, (Exception, enum.Enum)):
        return (
            f"{name}({thing.__base__.__name__})"  # signatures of these depend on Python's version
        )
    if callable(thing):
        text = re.sub(r"ForwardRef\((.*?)\)", r"\1", str(inspect.signature(thing)))
        return name + text.replace("'", "")
    return f"{name}: {type(thing).__name__}"


def members(cls: type) -> Iterator[tuple[str, Any]]:
    """Public members of a class with what they are; fields without a default by their annotation."""
    fields = {
        n: a
        for base in reversed(cls.__mro__)
        for n, a in base.__dict__.get("__annotations__", {}).items()
    }
    foreign = {
        n for base in cls.__mro__ if not base.__module__.startswith("kempe") for n in dir(base)
    }
    for name in sorted({*dir(cls), *fields} - foreign):
        if not name.startswith("_"):
            yield name, inspect.getattr_static(cls, name, fields.get(name))


def returned(cls: type) -> Iterator[type]:
    """Classes of the package that the methods of a class return."""
    for base in (c for c in cls.__mro__ if c.__module__.startswith("kempe")):
        module = importlib.import_module(base.__module__)
        text = Path(inspect.getfile(module)).read_text(encoding="utf-8")
        imported = {
            alias.asname or alias.name: (node.module, alias.name)
            for node in ast.walk(ast.parse(text))
            if isinstance(node, ast.ImportFrom) and node.module
            for alias in node.names
        }
        for _, thing in members(base):
            function = getattr(thing, "fget", None) or getattr(thing, "func", None) or thing
            annotation = getattr(function, "__annotations__", {}).get("return", "")
            for word in re.findall(r"\w+", str(annotation)):
                where, name = imported.get(word, (base.__module__, word))
                found = getattr(importlib.import_module(where), name, None)
                if inspect.isclass(found) and found.__module__.startswith("kempe."):
                    yield found


def page() -> str:
    """The list as text."""
    lines: list[str] = []
    classes: list[type] = []
    for name in sorted(kempe.__all__):
        thing = getattr(kempe, name)
        if isinstance(thing, ModuleType):
            rows = [(n, getattr(thing, n)) for n in sorted(getattr(thing, "__all__", vars(thing)))]
            own = [
                (n, x) for n, x in rows if not n.startswith("_") and not isinstance(x, ModuleType)
            ]
            lines += [
                f"kempe.{name}",
                *(f"    {signature(n, x)}" for n, x in own if is_ours(x)),
                "",
            ]
        elif inspect.isclass(thing):
            classes.append(thing)
        else:
            lines += [f"kempe.{signature(name, thing)}", ""]
    for cls in classes:  # grows while it is walked
        classes += [c for c in dict.fromkeys(returned(cls)) if c not in classes]
    for cls in classes:
        lines += [f"class {cls.__name__}", *(f"    {described(n, x)}" for n, x in members(cls)), ""]
    return "\n".join(lines)


def is_ours(thing: Any) -> bool:
    """Whether a name of a module was not imported from another package."""
    return getattr(thing, "__module__", "kempe").startswith("kempe")


def described(name: str, thing: Any) -> str:
    """A line about a member: its signature, or the annotation of a field."""
    return (
        f"{name}: {thing}"
        if isinstance(thing, str)
        else signature(name, getattr(thing, "__func__", thing))
    )


if __name__ == "__main__":
    OUT.write_text(page(), encoding="utf-8")
