"""Reports for a terminal or a file: answers as tables and sentences (rich renderables).

Print them with `show`, or with any rich console.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, TextIO

import numpy as np
from rich.cells import cell_len
from rich.console import Console, Group, RenderableType
from rich.table import Table
from rich.text import Text

from kempe import spatial
from kempe.cli import as_json
from kempe.errors import PROBLEM_LIMIT, DescriptionError, Fault
from kempe.model.configurations import units
from kempe.words import counted

if TYPE_CHECKING:
    from kempe.answers.answer import Answer
    from kempe.model.model import Model
    from kempe.motion.path import Path

WIDE = 100_000
"""Columns of an output that is not a terminal: nothing is cut or wrapped there."""

WORD = 20
"""Columns that a text in a table gets at least, if it has a word that long."""

NOTE_LIMIT = 10
REASON_LIMIT = 5
"""Notes about one file, and reasons why targets of a batch are not reached, that are shown."""

LONG = 1000
"""Lines of a table above which it is plain text."""

_KEYWORD = re.compile(
    r"kempe\.Budget\((\w+)=\.\.\.\)"
    r"|\b(columns|hold|lenient_limits|project|root|srdf|tolerance|xacro)="
    r"(True|\{name: value\}|\([^()]*\)|'[^']*'|[\d.e+-]*\d)"
)
"""Keyword arguments in messages of the library that options of commands give."""

_CONTROL = {i: f"\\x{i:02x}" for i in (*range(32), *range(127, 160)) if i not in (9, 10)}
"""Control characters, which a name from a file must not send to the terminal."""


def console(file: TextIO | None = None) -> Console:
    """A rich console that takes text literally, colours terminals only, and wraps nothing
    elsewhere.
    """
    target: TextIO = file or sys.stdout
    width = None if target.isatty() else WIDE
    return Console(
        file=target,
        width=width,
        markup=False,
        emoji=False,
        highlight=False,
        soft_wrap=width is not None,
    )


def show(renderable: RenderableType, file: TextIO | None = None) -> None:
    """Print a report to `file` (standard output unless given), without trailing blanks outside a
    terminal.

    A table that a narrow terminal has no place for is printed wider and wrapped there: no digit is
    cut off.
    """
    printer = console(file)
    if printer.is_terminal:
        width = printer.width
        for part in _parts(renderable):
            printer.width = max(width, _needed(part))
            printer.print(Group(part), crop=False)  # a lone Text would lose its no_wrap
        return
    with printer.capture() as captured:
        printer.print(renderable)
    printer.file.write("\n".join(line.rstrip() for line in captured.get().split("\n")))


def _parts(renderable: RenderableType) -> Iterator[RenderableType]:
    if isinstance(renderable, Group):
        for part in renderable.renderables:
            yield from _parts(part)
    else:
        yield renderable


def _needed(renderable: RenderableType) -> int:
    """Columns of the output that a table cannot do without: those of its numbers, and some of each
    text.
    """
    if not isinstance(renderable, Table):
        return 0
    total = 0
    for column in renderable.columns:
        texts = [str(cell) for cell in (column.header, *column.cells)]
        longest = max(
            (cell_len(t) for text in texts for t in ([text] if column.no_wrap else text.split())),
            default=0,
        )
        total += (longest if column.no_wrap else min(longest, WORD)) + 2
    return total


def in_options(text: str) -> str:
    """A message of the library with the options of commands in place of the same keyword arguments.

    `root='base'` becomes `--root base`, which can be typed; the names are the same.
    """

    def option(found: re.Match[str]) -> str:
        flag = f"--{(found[1] or found[2]).replace('_', '-')}"
        if found[3] in (None, "True", "(...)"):
            return flag
        value = "NAME=VALUE" if found[3] == "{name: value}" else found[3].strip("()'")
        flag = "--xacro-arg" if flag == "--xacro" else flag
        return f"{flag} {value.replace(', ', ',')}"

    return _KEYWORD.sub(option, text) if "=" in text else text


def clean(text: object) -> str:
    """`text` with control characters made visible, and options in place of keyword arguments."""
    return in_options(str(text)).translate(_CONTROL)


def table(
    columns: Sequence[str], lines: Iterable[Sequence[object]], title: str = ""
) -> Table | Text:
    """A light table; columns named with a leading '>' hold numbers (right, not wrapped), with '='
    are not wrapped.

    Of many lines it is plain text of the same look, for rich takes a millisecond a line.
    """
    lines = list(lines)
    if len(lines) > LONG:
        return _long_table(columns, lines, title)
    out = Table(
        box=None,
        pad_edge=False,
        padding=(0, 2, 0, 0),
        title=title or None,
        title_justify="left",
        header_style="bold",
        title_style="bold",
    )
    for name in columns:
        numeric = name.startswith(">")
        justify = "right" if numeric else "left"
        out.add_column(
            clean(name.lstrip(">=")),
            justify=justify,
            overflow="fold",
            no_wrap=numeric or name.startswith("="),
        )
    for line in lines:
        out.add_row(*(cell if isinstance(cell, Text) else clean(cell) for cell in line))
    return out


def _long_table(columns: Sequence[str], lines: Sequence[Sequence[object]], title: str) -> Text:
    """The text of a table."""
    cells = [[clean(name.lstrip(">=")) for name in columns]]
    cells += [[clean(cell) for cell in line] for line in lines]
    wide = [max(map(cell_len, column)) for column in zip(*cells, strict=True)]
    right = [name.startswith(">") for name in columns]
    out = [title] * bool(title)
    for line in cells:
        padded = (
            " " * (w - cell_len(x)) + x if r else x + " " * (w - cell_len(x))
            for x, w, r in zip(line, wide, right, strict=True)
        )
        out.append("  ".join(padded).rstrip())
    return Text("\n".join(out), no_wrap=True, overflow="ignore")


def number(x: float, digits: int = 6) -> str:
    """A number with fixed digits, without negative zero."""
    text = f"{x:.{digits}f}"
    return text[1:] if text.startswith("-") and not text.strip("-0.") else text


# ---- report of `kempe info`


def info(system: Model, degrees: bool = False) -> RenderableType:
    """A system: sizes, connectivity vector, freedoms, configuration space, bodies, joints, limits,
    ...
    """
    data = as_json.system_facts(system, degrees)
    blocks: list[RenderableType] = [_headline(data), "", _overview(data), "", _bodies(data)]
    for block in (
        _loops(data),
        _constraints(data),
        _couplings(data),
        _frames(data),
        _lines("Notes", data["notes"]),
    ):
        if block is not None:
            blocks += ["", block]
    return Group(*blocks)


def tree(system: Model) -> RenderableType:
    """The tree of bodies and joints in box characters, what closes loops, and the connectivity
    vector.
    """
    from kempe.views.overviews import tree_lines

    return Text("\n".join(clean(line) for line in tree_lines(system)))


def _headline(data: dict[str, Any]) -> Text:
    place = "in the plane" if data["dim"] == 2 else "in space"
    counts = (
        f"{count(len(data['bodies']) - 1, 'body', 'bodies')}, {count(len(data['joints']), 'joint')}"
    )
    return Text.assemble(
        (clean(data["name"]), "bold green"), f": {counts}, {place}; {data['kind']}"
    )


def _overview(data: dict[str, Any]) -> Table | Text:
    space = data["configuration_space"]
    loops = len(data["closures"])
    dof = str(data["dof_of_tree"])
    declared = sum(c["equations"] > 0 for c in data["constraints"])
    equations = space["constraints"]
    if equations:
        what = [count(loops, "loop")] if loops else []
        what += [count(declared, "constraint")] if declared else []
        of = " and ".join(what) or "coordinates that follow several others"
        left = max(data["nv"] - equations, 0)
        dof += (
            f" of the tree; {data['nv']} of all joints less {count(equations, 'equation')} of "
            f"{of}: at least {left}"
        )
        dof += "; kempe dof counts them truly"
    elif not loops:
        dof += " (a tree, no loops)"
    lines: list[tuple[str, str]] = [
        (
            "connectivity",
            "C = {"
            + ", ".join(map(str, data["parent"]))
            + "}  (parent of each body, 0 is the ground)",
        ),
        ("degrees of freedom", dof),
        ("configuration space", space["text"]),
        ("coordinates", f"q has {count(data['nq'], 'number')}"),
    ]
    if data["parameters"]:
        lines.append(
            ("parameters", ", ".join(f"{k} = {v:g}" for k, v in data["parameters"].items()))
        )
    if data["postures"]:
        lines.append(("postures", ", ".join(data["postures"])))
    if data["groups"]:
        lines.append(("groups of joints", ", ".join(data["groups"])))
    grid = Table.grid(padding=(0, 2, 0, 0))
    grid.add_column(style="bold", no_wrap=True)
    grid.add_column(overflow="fold")
    for name, text in lines:
        grid.add_row(name, clean(text))
    return grid


def _bodies(data: dict[str, Any]) -> Table | Text:
    joints = {j["name"]: j for j in data["joints"]}
    by_name = {c["name"]: c for c in data["coordinates"]}
    names = [b["name"] for b in data["bodies"]]
    lines: list[Sequence[object]] = [(0, names[0], "", "", "ground", "", "")]
    for body in data["bodies"][1:]:
        joint = joints[body["joint"]]
        kind = _kind(joint) + (" (walked backwards)" if joint["child"] != body["name"] else "")
        name = body["name"] + (" (particle)" if body["particle"] else "")
        lines.append(
            (body["number"], name, body["parent"], joint["name"], kind, *_of_joint(joint, by_name))
        )
    return table((">#", "body", ">parent", "joint", "=type", "=q", "=limits"), lines)


def _kind(joint: dict[str, Any]) -> str:
    units = {"pitch": " m/rad"}
    options = ", ".join(
        f"{k} {v:g}{units.get(k, '')}" if isinstance(v, float) else k
        for k, v in joint["options"].items()
    )
    return joint["type"] + (f", {options}" if options else "")


def _of_joint(joint: dict[str, Any], by_name: dict[str, dict[str, Any]]) -> tuple[str, str]:
    """Indices in q of a joint's coordinates, and their limits, as text."""
    own = [by_name[c] for c in joint["coordinates"] if c in by_name]
    if not own:
        return ("follows" if joint["coordinates"] else ""), ""
    first = own[0]["index"]
    last = own[-1]["index"]
    where = str(first) if first == last else f"{first}..{last}"
    parts: list[str] = []
    for c in own:
        if c["lower"] is not None or c["upper"] is not None:
            label = (
                f"{c['name'][len(joint['name']) + 1 :]} " if len(joint["coordinates"]) > 1 else ""
            )
            parts.append(
                f"{label}[{_bound(c['lower'], '-inf')}, {_bound(c['upper'], 'inf')}] {c['unit']}"
            )
    return where, ", ".join(parts)


def _bound(x: float | None, missing: str) -> str:
    return missing if x is None else f"{x:.5g}"


def _loops(data: dict[str, Any]) -> Table | Text | None:
    joints = {j["name"]: j for j in data["joints"]}
    by_name = {c["name"]: c for c in data["coordinates"]}
    lines = [
        (j["name"], _kind(j), f"{j['parent']} - {j['child']}", *_of_joint(j, by_name))
        for j in (joints[n] for n in data["closures"])
    ]
    columns = ("joint", "=type", "bodies", "=q", "=limits")
    return (
        table(columns, lines, "Loops, closed by the joints that the tree leaves out")
        if lines
        else None
    )


def _constraints(data: dict[str, Any]) -> Table | Text | None:
    lines: list[tuple[Any, str, str, Any]] = []
    for c in data["constraints"]:
        sided = ", one-sided" if c["one_sided"] else ""
        what = [f"{c['parent']} - {c['child']}"] if c["parent"] else []
        lines.append(
            (c["name"], f"{c['type']}{sided}", ", ".join([*what, *c.get("of", [])]), c["says"])
        )
    return (
        table(("constraint", "=type", "of", "what it asks"), lines, "Declared constraints")
        if lines
        else None
    )


def _couplings(data: dict[str, Any]) -> RenderableType | None:
    lines = [_coupling(c) for c in data["couplings"]] + data["relations"]
    return _lines("Coordinates that follow others", lines)


def _coupling(c: dict[str, Any]) -> str:
    if c["source"] is None:
        return f"{c['of']} = {c['offset']:g} (held)"
    factor = (
        ""
        if c["multiplier"] == 1.0
        else "-"
        if c["multiplier"] == -1.0
        else f"{c['multiplier']:g} "
    )
    offset = f" {'-' if c['offset'] < 0 else '+'} {abs(c['offset']):g}" if c["offset"] else ""
    return f"{c['of']} = {factor}{c['source']}{offset}"


def _frames(data: dict[str, Any]) -> RenderableType | None:
    return _lines("Frames", [f"{f['name']} on {f['body']}" for f in data["frames"]])


def _lines(title: str, lines: Sequence[str]) -> RenderableType | None:
    if not lines:
        return None
    return Group(Text(title, style="bold"), *(Text(f"  {clean(line)}") for line in lines))


# ---- report of `kempe check`


def findings(file: str, problems: Sequence[Fault], notes: Sequence[str] = ()) -> RenderableType:
    """What is wrong with a file: each problem with its place and a caret under it; then the notes."""
    found = count(len(problems), "problem") if problems else "no problems"
    noted = f", {count(len(notes), 'note')}" if notes else ""
    head = Text.assemble(
        clean(file), ": ", (found, "bold red" if problems else "bold green"), noted
    )
    shown = [_problem(p) for p in problems[:PROBLEM_LIMIT]]
    if len(problems) > PROBLEM_LIMIT:
        shown.append(Text(f"... and {len(problems) - PROBLEM_LIMIT} more"))
    said = [Text.assemble(("note ", "bold cyan"), clean(note)) for note in notes[:NOTE_LIMIT]]
    if len(notes) > NOTE_LIMIT:
        said.append(Text(f"... and {counted(len(notes) - NOTE_LIMIT, 'more note')}"))
    return Group(head, *shown, *said)


def _problem(problem: Fault) -> Text:
    text = Text(clean(problem))
    if problem.where:
        text.stylize("bold", 0, len(str(problem.where)))
    caret = problem.caret()
    if caret:
        line, mark = clean(caret).rsplit("\n", 1)
        text.append(f"\n{line}\n", "dim").append(mark, "bold red")
    return text


def error(problem: BaseException | str) -> RenderableType:
    """An error as one sentence; a description's problems each with its place and a caret."""
    head = Text("error: ", style="bold red")
    if isinstance(problem, DescriptionError):
        shown = [_problem(p) for p in problem.problems[:PROBLEM_LIMIT]]
        more = len(problem.problems) - len(shown)
        tail = [Text(f"... and {more} more")] if more else []
        return Group(head + shown[0], *shown[1:], *tail)
    return head + Text(clean(problem))


# ---- poses and configurations


def poses(
    system: Model, frame: str | None, X: spatial.Array, degrees: bool = False
) -> RenderableType:
    """Where a frame is, or all bodies are (`frame` None); of many configurations a line for each.

    X is what `System.fk` gives: (4, 4), (n, 4, 4), or for all bodies (k, 4, 4), (n, k, 4, 4).
    """
    units = f"metres and {'degrees' if degrees else 'radians'}"
    seen = f" of {clean(system.name)}, seen from {clean(system.body_names[0])}, in {units}"
    title = Text.assemble((clean(frame or "all bodies"), "bold green"), seen)
    if frame is not None and X.ndim == 2:
        return Group(title, "", _pose_table([()], (), X[None], degrees), "", Text(matrix(X)))
    if frame is not None:
        return Group(title, "", _pose_table([(i,) for i in range(len(X))], (">q",), X, degrees))
    bodies = list(enumerate(system.body_names))
    if X.ndim == 3:
        return Group(title, "", _pose_table(bodies, (">#", "body"), X, degrees))
    labels = [(i, *body) for i in range(len(X)) for body in bodies]
    return Group(title, "", _pose_table(labels, (">q", ">#", "body"), X.reshape(-1, 4, 4), degrees))


def _pose_table(
    labels: Sequence[tuple[Any, ...]], columns: tuple[str, ...], X: spatial.Array, degrees: bool
) -> Table | Text:
    places = 4 if degrees else 6
    cells = [
        (*label, *(number(x) for x in r[:3]), *(number(x, places) for x in r[3:]))
        for label, r in zip(labels, as_json.pose_rows(X, degrees).tolist(), strict=True)
    ]
    return table((*columns, ">x", ">y", ">z", ">roll", ">pitch", ">yaw"), cells)


def matrix(X: spatial.Array) -> str:
    """A matrix (n, m) as aligned text."""
    return "\n".join("  ".join(f"{number(x):>10}" for x in row) for row in np.asarray(X).tolist())


def solution(system: Model, answer: Answer, degrees: bool = False) -> RenderableType:
    """An answer of `ik`: its sentence, and the configuration by name; of many targets a line for
    each.
    """
    coordinates = as_json.coordinates(system, degrees)
    q = as_json.in_degrees(answer.q, system.coordinate_names, units(system), degrees)
    if np.ndim(answer.success):
        return Group(outcome(answer), *verdict(answer), "", _configurations(coordinates, q, answer))
    lines: list[tuple[Any, str, Any, str]] = []
    for c, x in zip(coordinates, q.tolist(), strict=True):
        limits = f"[{_bound(c['lower'], '-inf')}, {_bound(c['upper'], 'inf')}]"
        lines.append(
            (c["name"], _value(x, c), c["unit"], "" if c["lower"] is c["upper"] is None else limits)
        )
    title = "coordinate" if answer.success else "nearest found"
    shown: list[RenderableType] = [
        outcome(answer),
        "",
        table((title, ">value", "=unit", "=limits"), lines),
    ]
    shown += verdict(answer)
    if answer.success and lines:
        copy = f"--q {','.join(number(x, 9).rstrip('0').rstrip('.') for x in q.tolist())}"
        shown += ["", Text(copy, style="dim", no_wrap=True, overflow="ignore")]
    return Group(*shown)


def verdict(answer: Answer | Path) -> list[Text]:
    """What the judge says of configurations that were found, as a line; none where there are too
    many to look at.
    """
    if answer.q.size > as_json.MOST_JUDGED or not (said := answer.verdict):
        return []
    bad = np.any(np.asarray(getattr(answer, "success", True)) & ~np.asarray(answer.judged.holds))
    return [Text(clean(said), style="bold red" if bad else "dim")]


def outcome(answer: Answer) -> Text:
    """The sentence of an answer of `ik`, or how many of a batch of targets are reached and which
    are not.
    """
    if np.ndim(answer.success) == 0:
        return Text(clean(answer.status), style="bold green" if answer.success else "bold red")
    missed = np.flatnonzero(~np.asarray(answer.success)).tolist()
    text = Text(str(answer), style="bold red" if missed else "bold green")
    for row in missed[:REASON_LIMIT]:
        text.append(f"\nrow {row}: {clean(answer.sentence((row,)))}", "red")
    if len(missed) > REASON_LIMIT:
        text.append(f"\nand {rows_text(missed[REASON_LIMIT:])}", "red")
    return text


def rows_text(numbers: Sequence[int]) -> str:
    """'row 3', 'rows 3, 4, ...'."""
    more = ", ..." if len(numbers) > 12 else ""
    return f"row{'s' * (len(numbers) > 1)} {', '.join(map(str, numbers[:12]))}{more}"


def _configurations(
    coordinates: list[dict[str, Any]], q: spatial.Array, answer: Answer
) -> Table | Text:
    columns = (
        ">target",
        "reached",
        *(f">{c['name']} [{c['unit']}]" if c["unit"] else f">{c['name']}" for c in coordinates),
    )
    cells = [
        (i, "yes" if good else "no", *(_value(x, c) for x, c in zip(row, coordinates, strict=True)))
        for i, (good, row) in enumerate(zip(answer.success, q.tolist(), strict=True))
    ]
    return table(columns, cells)


def _value(x: float, coordinate: dict[str, Any]) -> str:
    return number(x, 4 if coordinate["unit"] == "deg" else 6)


def count(n: int, one: str, many: str = "") -> str:
    """'1 joint', '2 joints', '2 bodies'."""
    return f"{n} {one if n == 1 else many or one + 's'}"
