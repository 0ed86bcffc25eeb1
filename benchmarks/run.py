"""Measure Kempe beside the kinematics libraries that are installed, and write results.md beside this file.

    python benchmarks/run.py

It takes about ten minutes. The file is written after each section, so an interruption keeps what is done. Single
sections: `kempe bench --only batch`; more targets: `kempe bench --only numeric --targets 10000`.
"""

from __future__ import annotations

import sys
from pathlib import Path

from kempe.views import report
from kempe.views.benchmark import Table, benchmark, page

RESULTS = Path(__file__).with_name("results.md")


def say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def main() -> int:
    tables: list[Table] = []
    try:
        for table in benchmark(say=say):
            tables.append(table)
            RESULTS.write_text(page(tables), encoding="utf-8")
            report.show(report.measured(table))
    except KeyboardInterrupt:
        say(f"interrupted after {len(tables)} sections; {RESULTS} holds them" if tables else "interrupted")
        return 130
    missed = [f"{table.title}: {goal}" for table in tables for goal in table.goals if not goal.met]
    say("\n".join([f"written to {RESULTS}", *missed]))
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
