"""The C source of the layer between Python and the compiled kernels: layer.c, then one function a
kernel.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

ENTRY = {
    "f": ("double", "NPY_DOUBLE", "float64"),
    "i": ("int64_t", "NPY_INT64", "int64"),
    "b": ("uint8_t", "", ""),
}
NUMBERS = {
    "f": (
        "double x{0} = PyFloat_AsDouble(a[{0}]); if (x{0} == -1.0 && PyErr_Occurred()) return NULL;"
    ),
    "i": "int64_t x{0} = as_int64(a[{0}]); if (x{0} == -1 && PyErr_Occurred()) return NULL;",
    "b": "int x{0} = PyObject_IsTrue(a[{0}]); if (x{0} < 0) return NULL;",
}
"""How a number is read."""


def is_array(taken: dict[str, Any]) -> bool:
    """Whether an argument is an array."""
    return "shape" in taken


def source(
    kernels: list[dict[str, Any]], variants: dict[str, int], sources: str, builder: str
) -> str:
    """The whole C source.

    kernels: name, label, names and what they take, as `emit` writes them. variants: the level of
    the processor that each needs, the best first. sources, builder: digests of the sources of the
    kernels and of the builder.
    """
    parts = [(Path(__file__).parent / "layer.c").read_text()]
    for kernel in kernels:
        parts += [*prototypes(kernel, variants), *function(kernel)]
    return "\n".join(
        [*parts, *table(kernels), *choice(kernels, variants), module(sources, builder), ""]
    )


def parameters(kernel: dict[str, Any]) -> str:
    """Parameters of a kernel as Numba calls it: a place for the result and for an error, then each
    array as its owner (none), its object (none), number of entries, their size, the data, lengths
    and strides of the axes.
    """
    out = ["int64_t *", "void **"]
    for taken in kernel["takes"]:
        if is_array(taken):
            out += ["void *", "void *", "int64_t", "int64_t", "void *"] + ["int64_t"] * 2 * len(
                taken["shape"]
            )
        else:
            out.append(ENTRY[taken["entry"]][0])
    return ", ".join(out)


def prototypes(kernel: dict[str, Any], variants: dict[str, int]) -> Iterator[str]:
    """The kernel in all variants, and the pointer to the chosen one."""
    for variant in variants:
        yield f"extern int32_t kempe_{kernel['name']}_{variant}({parameters(kernel)});"
    yield f"static int32_t (*chosen_{kernel['name']})({parameters(kernel)});"


def function(kernel: dict[str, Any]) -> Iterator[str]:
    """The function that Python calls."""
    name = kernel["name"]
    takes = kernel["takes"]
    arrays = [i for i, taken in enumerate(takes) if is_array(taken)]
    names = ", ".join(f'"{n}"' for n in kernel["names"])
    yield f"static const char *const names_{name}[] = {{{names}}};"
    yield (
        f'static const Called called_{name} = {{"{kernel["label"]}", {len(takes)}, names_{name}}};'
    )
    yield f"static PyObject *enter_{name}(PyObject *self, PyObject *const *a, Py_ssize_t n) {{"
    yield f"    const Called *called = &called_{name}; Given g[{len(arrays)}]; (void)self;"
    yield f"    if (n != {len(takes)}) return wrong_count(called, n);"
    # first of all: to read a number may run code that changes arrays
    for i, taken in enumerate(takes):
        if not is_array(taken):
            yield f"    {NUMBERS[taken['entry']].format(i)}"
    handed = ["&result", "&error"]
    for i, taken in enumerate(takes):
        if not is_array(taken):
            handed.append(f"({ENTRY[taken['entry']][0]})x{i}")
            continue
        k = arrays.index(i)
        axes = len(taken["shape"])
        _, number, word = ENTRY[taken["entry"]]
        kind = (
            f"a {'writable, ' if taken['written'] else ''}C-contiguous {word} array with {axes} "
            "axes"
        )
        yield f"    if (!fits(a[{i}], {number}, {axes}, {int(taken['written'])}, g + {k}))"
        yield f'        return wrong_kind(called, {i}, "{kind}");'
        handed += ["NULL", "NULL", f"(int64_t)(g[{k}].size / 8)", "8", f"g[{k}].data"]
        handed += [f"g[{k}].{what}[{j}]" for what in ("dims", "strides") for j in range(axes)]
    yield from lengths(takes, arrays)
    yield "    int64_t result = 0; void *error = NULL; int32_t status;"
    yield f"    if (guard && !guard_in(g, {len(arrays)})) return PyErr_NoMemory();"
    call = f"status = chosen_{name}({', '.join(handed)});"
    yield (
        f"    Py_BEGIN_ALLOW_THREADS {call} Py_END_ALLOW_THREADS"
        if kernel["nogil"]
        else f"    {call}"
    )
    yield f"    if (guard) guard_out(g, {len(arrays)});"
    yield (
        "    if (status && status != NONE) return PyErr_NoMemory(); /* no room for scratch: "
        "nothing else can fail */"
    )
    yield f"    return {'PyLong_FromLongLong(result)' if kernel['returns'] else 'none()'};\n}}"


def lengths(takes: list[dict[str, Any]], arrays: list[int]) -> Iterator[str]:
    """Checks of the lengths of axes against numbers and against each other."""
    axes = [
        (k, i, j, length)
        for k, i in enumerate(arrays)
        for j, length in enumerate(takes[i]["shape"])
    ]
    known: dict[str, str] = {}
    for k, _, j, length in axes:
        if isinstance(length, str) and length.isalpha():
            known.setdefault(length, f"g[{k}].dims[{j}]")
    for k, i, j, length in axes:
        here = f"g[{k}].dims[{j}]"
        expected = str(length)
        also = ""
        hint = ""
        if isinstance(length, str):
            either, _, letter = length.rpartition("|")
            letter, _, more = letter.partition("+")
            if letter == "_" or known.get(letter) == here:
                continue
            if letter not in known:
                raise ValueError(
                    f"argument {i}: length {length!r}, but no axis has the length {letter!r}"
                )
            expected = known[letter] + (f" + {more}" if more else "")
            if either:
                also = f" && {here} != {either}"
                hint = f" or {either}"
        wrong = f'wrong_length(called, {i}, {j}, {here}, {expected}, "{hint}")'
        yield f"    if ({here} != {expected}{also}) return {wrong};"


def table(kernels: list[dict[str, Any]]) -> Iterator[str]:
    """The list of functions."""
    yield "static PyObject *use(PyObject *self, PyObject *name);"
    yield "static PyObject *variant(PyObject *self, PyObject *unused);"
    yield "static PyObject *maker(PyObject *self, PyObject *shape);"
    yield "static PyMethodDef methods[] = {"
    yield '    {"use", use, METH_O, "Run the kernels of this variant from now on."},'
    yield '    {"maker", maker, METH_O, "A function that makes float64 arrays of this shape."},'
    yield '    {"variant", variant, METH_NOARGS, "The variant that runs."},'
    for kernel in kernels:
        name = kernel["name"]
        yield (
            f'    {{"{name}", (PyCFunction)(void (*)(void))enter_{name}, METH_FASTCALL, '
            f'"{declaration(kernel)}"}},'
        )
    yield "    {NULL, NULL, 0, NULL}};"


def declaration(kernel: dict[str, Any]) -> str:
    """The declaration of a kernel in one line: "module.function(name: kind[lengths], ...)", "!" for
    what is written.
    """
    parts = []
    for name, taken in zip(kernel["names"], kernel["takes"], strict=True):
        lengths = f"[{', '.join(map(str, taken['shape']))}]" if is_array(taken) else ""
        parts.append(f"{name}: {taken['entry']}{lengths}{'!' if taken.get('written') else ''}")
    return f"{kernel['label']}({', '.join(parts)})"


def choice(kernels: list[dict[str, Any]], variants: dict[str, int]) -> Iterator[str]:
    """Which variants there are, and the choice of one."""
    rows = ", ".join(f'{{"{v}", {level}}}' for v, level in variants.items())
    yield f"static const struct {{ const char *name; int level; }} variants[] = {{{rows}}};"
    yield f"enum {{ N_VARIANTS = {len(variants)} }};"
    yield "static int running = -1;"
    yield "static void choose(int which) {\n    running = which;\n    switch (which) {"
    for k, v in enumerate(variants):
        yield f"    case {k}:"
        yield from (
            f"        chosen_{kernel['name']} = kempe_{kernel['name']}_{v};" for kernel in kernels
        )
        yield "        break;"
    yield "    }\n}"


def module(sources: str, builder: str) -> str:
    """The functions of the module itself, and the module."""
    text = (Path(__file__).parent / "module.c").read_text()
    return text.replace(
        '"@SOURCES@"', "\n        ".join(f'"{line}\\n"' for line in sources.splitlines())
    ).replace("@BUILDER@", builder)
