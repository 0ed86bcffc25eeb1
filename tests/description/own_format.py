"""A format of one's own, declared in tests only: Denavit-Hartenberg rows of a chain as
comma-separated values.
"""

from __future__ import annotations

import csv
import io

import numpy as np

from kempe.description.dh import from_dh
from kempe.description.formats import Format
from kempe.description.mechanism import Mechanism
from kempe.description.source import Findings, decode_text

HEAD = ("type", "a", "alpha", "d", "theta")
CANNOT = {
    "trees and loops": "each body of a chain carries one joint at most",
    "joints that are neither revolute nor prismatic": "a row turns about z or slides along it",
}


def read_rows(text: str | bytes, source: str) -> Mechanism:
    """The chain of a table."""
    rows = csv.DictReader(io.StringIO(decode_text(text, source)))
    number = {key: float for key in HEAD[1:]}
    return from_dh([{k: number.get(k, str)(v) for k, v in row.items()} for row in rows])


def write_rows(mechanism: Mechanism) -> str:
    """The table of a chain that `read_rows` or `from_dh` made."""
    findings = Findings()
    last = mechanism.ground.name
    lines = [",".join(HEAD)]
    for joint in mechanism.joints.values():
        if joint.type.type_name not in ("revolute", "prismatic"):
            allowed = CANNOT["joints that are neither revolute nor prismatic"]
            findings.add_problem(
                f"it is {joint.type.type_name}", f"joint {joint.name!r}", joint.where, allowed
            )
        if joint.parent != last:
            findings.add_problem(
                "it leaves the chain",
                f"joint {joint.name!r}",
                joint.where,
                CANNOT["trees and loops"],
            )
        before, after = (
            angle_and_shift(X.evaluate_pose(mechanism.parameters), axis)
            for X, axis in ((joint.X_PF, 2), (joint.X_CM.invert_steps(), 0))
        )
        lines.append(
            ",".join([joint.type.type_name, *map(repr, (*reversed(after), *reversed(before)))])
        )
        last = joint.child
    findings.raise_problems()
    return "\n".join(lines) + "\n"


def angle_and_shift(pose: np.ndarray, axis: int) -> tuple[float, float]:
    """Turn about an axis and slide along it, of a pose (4, 4) that is both."""
    i, j = ((1, 2), (2, 0), (0, 1))[axis]
    return float(np.arctan2(pose[j, i], pose[i, i])), float(pose[axis, 3])


ROWS = Format(
    "rows of a DH table",
    (".csv",),
    read_rows,
    write_rows,
    recognises=lambda start: start.startswith(",".join(HEAD)),
    cannot=CANNOT,
    loses=("names", "limits", "frames"),
)
