"""Timing side by side: statements take turns, medians count, tables compare them with Kempe."""

from __future__ import annotations

import statistics
import time
import timeit
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

ROUNDS = 9
"""How often each statement has its turn."""
TURN = 0.02
"""Seconds that a turn of a fast statement lasts; a slow one runs once a turn."""


def significant(x: float) -> str:
    """A number with three significant digits, without exponent."""
    return f"{x:.0f}" if abs(x) >= 100 else f"{x:.3g}"


@dataclass(frozen=True)
class Case:
    """A statement to time: whose, what it does, its code with the names in it, results of one run."""

    library: str
    call: str
    code: str
    names: dict[str, Any]
    results: int = 1


def cases(
    library: str, names: dict[str, Any], *calls: tuple[str, str] | tuple[str, str, int]
) -> list[Case]:
    """Cases of one library that share names, from (call, code) or (call, code, results)."""
    return [Case(library, call[0], call[1], names, *call[2:]) for call in calls]


@dataclass(frozen=True)
class Row:
    """One line of a table: a number for a library's call (a median), and the best one that was
    seen.
    """

    library: str
    call: str
    value: float
    best: float | None = None


@dataclass(frozen=True)
class Goal:
    """A bound that the project sets itself: the text, the number measured, and whether it is met."""

    text: str
    measured: float
    met: bool

    def __str__(self) -> str:
        return f"{self.text}: {significant(self.measured)} ({'met' if self.met else 'NOT MET'})"


@dataclass
class Table:
    """What one section measured. Ratios are to the first row."""

    title: str
    unit: str
    rows: list[Row] = field(default_factory=list)
    goals: list[Goal] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    ratios: bool = True
    words: ClassVar[int] = 2
    """Columns that hold words; the others hold numbers."""

    def value(self, library: str, call: str = "") -> float | None:
        """The number of a library's first row whose call begins so, or None where it was not
        measured.
        """
        row = self._row(library, call)
        return None if row is None else row.value

    def best(self, library: str, call: str = "") -> float | None:
        """As `value`, but the best turn: what the machine can do when nothing else disturbs it."""
        row = self._row(library, call)
        return None if row is None else row.value if row.best is None else row.best

    def _row(self, library: str, call: str) -> Row | None:
        return next(
            (r for r in self.rows if r.library == library and r.call.startswith(call)), None
        )

    def at_most(self, text: str, value: float | None, bound: float) -> None:
        """Record the goal that a number is at most `bound`; nothing where it was not measured."""
        if value is not None:
            self.goals.append(Goal(text, value, value <= bound))

    def at_least(self, text: str, value: float | None, bound: float) -> None:
        """Record the goal that a number is at least `bound`; nothing where it was not measured."""
        if value is not None:
            self.goals.append(Goal(text, value, value >= bound))

    def ratio(self, library: str, call: str, to: str) -> float | None:
        """How many times Kempe's call `to` a library's call needs, or None."""
        a = self.value(library, call)
        b = self.value("Kempe", to)
        return None if a is None or b is None else a / b

    def behind(self) -> list[str]:
        """Remarks on what of Kempe is slower than others; none where lines of different libraries
        do not compare.
        """
        return []

    def data(self) -> dict[str, Any]:
        """The table as plain data."""
        return {
            "title": self.title,
            "unit": self.unit,
            "rows": [vars(r) for r in self.rows],
            "goals": [vars(g) for g in self.goals],
            "remarks": list(self.remarks),
        }

    def columns(self) -> tuple[list[str], list[list[str]]]:
        """Header and cells of the table as text: the best turn and the ratio where they mean
        something.
        """
        best = any(row.best is not None for row in self.rows)
        times = self.ratios and len(self.rows) > 1
        header = [
            "library",
            "call",
            self.unit,
            *(["best"] if best else []),
            *(["ratio"] if times else []),
        ]
        cells = []
        for row in self.rows:
            line = [row.library, row.call, significant(row.value)]
            line += [significant(row.value if row.best is None else row.best)] if best else []
            line += [significant(row.value / self.rows[0].value)] if times else []
            cells.append(line)
        return header, cells

    def markdown(self) -> str:
        """The table as Markdown."""
        header, cells = self.columns()
        rule = ["---"] * self.words + ["--:"] * (len(header) - self.words)
        lines = [
            f"## {self.title}",
            "",
            *(f"| {' | '.join(line)} |" for line in (header, rule, *cells)),
        ]
        for title, items in (("Goals", self.goals), ("Remarks", self.remarks)):
            if items:
                lines += ["", f"{title}:", "", *(f"- {item}" for item in items)]
        return "\n".join(lines) + "\n"


class Grid(Table):
    """A table with a line for each call, a column for each library, and the unit in the corner."""

    words = 1

    def columns(self) -> tuple[list[str], list[list[str]]]:
        """Header and cells as text; a dash where something was not measured."""
        libraries = list(dict.fromkeys(row.library for row in self.rows))
        found = {(row.call, row.library): significant(row.value) for row in self.rows}
        calls = dict.fromkeys(row.call for row in self.rows)
        return [self.unit, *libraries], [
            [call, *(found.get((call, x), "-") for x in libraries)] for call in calls
        ]

    def behind(self) -> list[str]:
        """A remark for each column of Kempe that is slower somewhere than the fastest other library
        of the line.
        """
        if self.unit not in ("s", "ms", "us", "ns"):
            return []
        found: dict[str, list[str]] = {}
        for call in dict.fromkeys(row.call for row in self.rows):
            line = [row for row in self.rows if row.call == call]
            others = [row for row in line if not row.library.startswith("Kempe")]
            if not others:
                continue
            first = min(others, key=lambda row: row.value)
            for row in line:
                if row.library.startswith("Kempe") and row.value > first.value:
                    text = (
                        f"{call} ({significant(row.value / first.value)} times as long as "
                        f"{first.library})"
                    )
                    found.setdefault(row.library, []).append(text)
        return [f"behind: {library}: {'; '.join(lines)}" for library, lines in found.items()]


def measure(cases: Sequence[Case], scale: float = 1e9) -> list[Row]:
    """Median and best time of one result of each case, in units of 1/`scale` seconds.

    The cases take turns (A B C A B C ...), so that a drift of the machine's speed meets all of them
    alike; garbage collection is off inside a turn.
    """
    timers = [
        timeit.Timer(c.code, timer=time.perf_counter_ns, globals=dict(c.names)) for c in cases
    ]
    numbers = []
    for timer in timers:
        timer.timeit(1)
        once = max(timer.timeit(1), 100.0)
        numbers.append(max(1, int(TURN * 1e9 / once)))
    turns: list[list[float]] = [[] for _ in cases]
    for _ in range(ROUNDS):
        for case, timer, number, record in zip(cases, timers, numbers, turns, strict=True):
            record.append(timer.timeit(number) / (number * case.results))
    unit = scale * 1e-9
    return [
        Row(case.library, case.call, statistics.median(record) * unit, min(record) * unit)
        for case, record in zip(cases, turns, strict=True)
    ]
