"""Measure Kempe beside the kinematics libraries that are installed, and write results.md beside
this file.

    python benchmarks/run.py
    python benchmarks/run.py --only numeric --targets 10000 --out numeric.md

It takes about ten minutes. The file is written after each section, so an interruption keeps what is
done.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from kempe_bench import SECTIONS, Table, benchmark, page, peers, shown

from kempe.cli import terminal
from kempe.errors import UnknownNameError

RESULTS = Path(__file__).with_name("results.md")


def say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "--only",
        action="append",
        metavar="SECTION",
        help=f"one of {', '.join(SECTIONS)}; repeatable",
    )
    parser.add_argument(
        "--peer", action="append", metavar="NAME", help="a library to compare with; repeatable"
    )
    parser.add_argument(
        "--targets", type=int, metavar="N", help="targets of each robot, numeric and whole_body"
    )
    parser.add_argument(
        "-o", "--out", type=Path, metavar="FILE", help="file to write (results.md if all is run)"
    )
    parser.add_argument("--json", action="store_true", help="print JSON in place of tables")
    return parser.parse_args()


def main() -> int:
    given = arguments()
    whole = not (given.only or given.peer or given.targets)
    out = given.out or (RESULTS if whole else None)
    tables: list[Table] = []
    try:
        for table in benchmark(given.only, given.peer, say, given.targets):
            tables.append(table)
            if out is not None:
                out.write_text(page(tables, given.peer), encoding="utf-8")
            if not given.json:
                terminal.print_text(shown(table))
    except UnknownNameError as error:
        say(str(error))
        return 2
    except KeyboardInterrupt:
        say(
            f"interrupted after {len(tables)} sections"
            + (f"; {out} holds them" if tables and out else "")
        )
        return 130
    if given.json:
        print(json.dumps({"machine": peers.machine(), "tables": [t.data() for t in tables]}))
    missed = [f"{table.title}: {goal}" for table in tables for goal in table.goals if not goal.met]
    say("\n".join([f"written to {out}"] * (out is not None) + missed))
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
