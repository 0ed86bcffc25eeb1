"""Names of branches, such as elbow up, from the joint axes of an arm at a configuration.

Each word is the sign of one factor of the determinant of the Jacobian, so it changes at a singular
configuration and nowhere else. Nothing of it depends on where the joints have their zero, on the
base, or on the tool.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from kempe.arguments import read_names
from kempe.errors import InputError, UnknownNameError
from kempe.inverse.closed_forms.chain_lines import Lines, compute_line_placements
from kempe.inverse.closed_forms.plan import ChainPlan
from kempe.inverse.closed_forms.structure import (
    EXACT,
    are_parallel,
    do_axes_meet,
    is_spherical_triple,
)
from kempe.kernels.forward.table_layout import SLIDE, TURN
from kempe.spatial import Array

BORDER = 1e-9
"""Sine, or length in those of the chain, below which a configuration is singular and a word has no
side to name."""

MERGED = 1e-5
"""The same for configurations in which solutions have merged, which rounding moves by the root of
its size."""

CENTRED = 1e-7
"""Offset of an arm from its first axis, in lengths of the chain, that counts as none."""

PLANAR = (("elbow-up", "elbow-down", "elbow singular"),)
SPATIAL = (
    ("shoulder left", "shoulder right", "shoulder singular"),
    ("elbow up", "elbow down", "elbow singular"),
    ("no flip", "flip", "wrist singular"),
)
"""Words of each side, and on the border between them."""

SLIDING = (
    SPATIAL[0],
    ("slide ahead", "slide back", "slide singular"),
    SPATIAL[2],
)
"""The same where the elbow slides, as of the Stanford arm."""

WRIST = (SPATIAL[2],)
"""The same of three slides and a wrist."""

SEVEN = tuple(
    (f"{name} +", f"{name} -", f"{name} singular") for name in ("shoulder", "elbow", "wrist")
)
"""Words of arms of seven turns with a spherical shoulder and wrist: signs of joints 2, 4 and 6."""

NEITHER = ("elbow +", "elbow -")
"""Words for an elbow that is bent about axis 2 in the positive or negative sense, where the
shoulder is singular."""


@dataclass(frozen=True)
class Kind:
    """A kind of arm whose branches have names: the `words` of each choice."""

    words: tuple[tuple[str, str, str], ...]
    three_parallel: bool = False

    @property
    def allowed_words(self) -> list[str]:
        """All words that names of branches can contain."""
        return [word for choice in self.words for word in choice] + list(NEITHER) * (
            self.words == SPATIAL
        )


def recognise_kind(plan: ChainPlan, planar: bool) -> Kind | None:
    """Recognise the kind of arm of a plan; None where its branches have no names."""
    lines = plan.lines
    n = len(lines)
    turns = np.flatnonzero(lines.kinds == TURN)
    if n == len(turns) == 7 and plan.task == "pose":
        return _recognise_seven_turns(lines)
    if plan.locked:
        return None
    if planar:
        bends = (n, plan.task) in ((2, "position"), (2, "pose"), (3, "pose"))
        return Kind(PLANAR) if bends and len(turns) == n else None
    if all(are_parallel(h, lines.h[0]) for h in lines.h):  # as of a SCARA
        bends = (len(turns), plan.task) in ((2, "position"), (3, "pose")) and n <= len(turns) + 1
        return Kind(PLANAR) if bends else None
    if len(turns) < n:
        return _recognise_sliding_kind(plan)
    if (
        n != 6
        or plan.task != "pose"
        or are_parallel(lines.h[0], lines.h[1])
        or not are_parallel(lines.h[1], lines.h[2])
    ):
        return None
    three = are_parallel(lines.h[2], lines.h[3])
    wrist = is_spherical_triple(lines, 3) or (
        three and not are_parallel(lines.h[3], lines.h[4]) and do_axes_meet(lines, 4, 5)
    )
    if not wrist:
        return None
    kind = Kind(SPATIAL, three and not is_spherical_triple(lines, 3))
    _, h, o = compute_line_placements(lines, np.zeros((1, n)))
    return (
        kind
        if all(float(size[0]) > MERGED for size in _compute_branch_measures(kind, h, o)[1])
        else None
    )


def _recognise_sliding_kind(plan: ChainPlan) -> Kind | None:
    """Recognise an arm of six joints with slides before a spherical wrist."""
    lines = plan.lines
    if len(lines) != 6 or plan.task != "pose" or not is_spherical_triple(lines, 3):
        return None
    before = lines.kinds[:3]
    if np.all(before == SLIDE):
        return Kind(WRIST)
    across = (
        not are_parallel(lines.h[0], lines.h[1]) and abs(float(lines.h[1] @ lines.h[2])) <= EXACT
    )
    return Kind(SLIDING) if before.tolist() == [TURN, TURN, SLIDE] and across else None


def _recognise_seven_turns(lines: Lines) -> Kind | None:
    """Recognise an arm of seven turns with a spherical shoulder and a spherical wrist."""
    if not (is_spherical_triple(lines, 0) and is_spherical_triple(lines, 4)):
        return None
    _, h, o = compute_line_placements(lines, np.zeros((1, 7)))
    return (
        Kind(SEVEN)
        if all(float(size[0]) > MERGED for size in _measure_seven_turns(h, o)[1])
        else None
    )


def name_branches(
    kind: Kind, lines: Lines, theta: Array, merged: np.ndarray | None = None
) -> np.ndarray:
    """Name the branches (m,) of configurations theta (m, n) of an arm.

    `merged` (m,) marks merged solutions.
    """
    tip, h, o = compute_line_placements(lines, theta)
    border = np.where(np.zeros(len(theta), bool) if merged is None else merged, MERGED, BORDER)
    bend: Array | None = None
    if kind.words == PLANAR:
        signs = [_measure_planar_bend(h, o, tip[:, :3, 3], np.flatnonzero(lines.kinds == TURN))]
    elif kind.words == WRIST:
        signs = [_measure_middle_turn(h, 3)]
    elif kind.words == SEVEN:
        signs = list(_measure_seven_turns(h, o)[0])
    elif kind.words == SLIDING:  # the wrist is ahead of axis 2, or on the other side of it
        slid = np.einsum("mi,mi->m", _find_centre(h, o) - o[:, 1], h[:, 2])
        signs = [_measure_shoulder(h, o, _find_centre(h, o)), slid, _measure_middle_turn(h, 3)]
    else:
        (shoulder, bend, turn), _ = _compute_branch_measures(kind, h, o)
        signs = [shoulder, np.sign(_measure_wrist_offset(h, o)) * bend, turn]
    columns: list[Array] = []
    for sign, (above, below, on) in zip(signs, kind.words, strict=True):
        side = np.where(sign > 0.0, above, below)
        columns.append(np.where(np.isnan(sign), "", np.where(np.abs(sign) > border, side, on)))
    # with the wrist neither ahead nor behind, up and down cannot be distinguished
    if bend is not None:
        unclear = (np.abs(signs[0]) <= border) & (np.abs(bend) > border)
        columns[1] = np.where(unclear, np.where(bend < 0.0, *NEITHER), columns[1])
    return np.array([", ".join(row) for row in zip(*columns, strict=True)], dtype=object)


def match_branch_names(
    kind: Kind | None, names: np.ndarray, words: str | Iterable[str]
) -> np.ndarray:
    """Return a mask of the names that contain all given words.

    Hyphens and spaces are alike. Errors: `InputError`, `UnknownNameError`.
    """
    if kind is None:
        raise InputError(
            "the branches of this chain have no names; `branch` has their numbers where there are "
            "any"
        )
    wanted = words.split(",") if isinstance(words, str) else read_names(words, "words")
    wanted = [word.strip() for word in wanted]
    known = kind.allowed_words
    spelled = {_normalise_word(word): word for word in known}
    for word in wanted:
        if _normalise_word(word) not in spelled:
            raise UnknownNameError("branch", word, known, "the chain")
    wanted = [spelled[_normalise_word(word)] for word in wanted]
    flat = [all(word in name.split(", ") for word in wanted) for name in names.ravel()]
    return np.array(flat, dtype=bool).reshape(names.shape)


def _normalise_word(word: str) -> str:
    """Normalise a word for comparison: hyphens between letters become single spaces.

    "elbow -" keeps its sign.
    """
    return " ".join(re.sub(r"(?<=\w)-(?=\w)", " ", word).split())


def _measure_planar_bend(h: Array, o: Array, tip: Array, turns: np.ndarray) -> Array:
    """Measure the bend (m,) of a planar elbow: positive to the left of the way to the tip.

    Of the joints `turns` turn; it is seen from where the first axis points to.
    """
    up = h[:, turns[0]]
    first = o[:, turns[1]] - o[:, turns[0]]
    second = (o[:, turns[2]] if len(turns) > 2 else tip) - o[:, turns[1]]
    first, second = (v - up * np.einsum("mi,mi->m", v, up)[:, None] for v in (first, second))
    size = np.linalg.norm(first, axis=1) * np.linalg.norm(second, axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        sine = np.einsum("mi,mi->m", up, np.cross(second, first)) / size
    return np.where(size > CENTRED, sine, np.nan)


def _find_centre(h: Array, o: Array, k: int = 4) -> Array:
    """Find the point (m, 3) in which axes k and k + 1 (from 0) meet."""
    a = h[:, k]
    b = h[:, k + 1]
    d = o[:, k + 1] - o[:, k]
    n = np.cross(a, b)
    return (
        o[:, k]
        + a * (np.einsum("mi,mi->m", np.cross(d, b), n) / np.einsum("mi,mi->m", n, n))[:, None]
    )


def _measure_wrist_offset(h: Array, o: Array) -> Array:
    """Measure the distance (m,) of the wrist from axis 1 along h1 x h2.

    It is zero where the turn of axis 1 moves the wrist along axis 2.
    """
    return np.einsum("mi,mi->m", _find_centre(h, o) - o[:, 0], np.cross(h[:, 0], h[:, 1]))


def _measure_shoulder(h: Array, o: Array, centre: Array) -> Array:
    """Measure the side (m,) on which the arm passes axis 1: positive on the right.

    It counts the offset of the arm from axis 1, so that the sense of axis 2 does not matter where
    there is one.
    """
    across = np.cross(h[:, 0], h[:, 1])
    size2 = np.einsum("mi,mi->m", across, across)
    foot = (
        o[:, 0]
        + h[:, 0]
        * (np.einsum("mi,mi->m", np.cross(o[:, 1] - o[:, 0], h[:, 1]), across) / size2)[:, None]
    )
    offset = np.einsum("mi,mi->m", centre - foot, h[:, 1])
    return -np.where(np.abs(offset) > CENTRED, np.sign(offset), 1.0) * _measure_wrist_offset(h, o)


def _measure_middle_turn(h: Array, k: int) -> Array:
    """Measure the sine (m,) by which axis k + 1 turns axis k towards axis k + 2, relative."""
    turn = np.einsum("mi,mi->m", h[:, k + 1], np.cross(h[:, k], h[:, k + 2]))
    parts = (np.linalg.norm(np.cross(h[:, i], h[:, i + 1]), axis=1) for i in (k, k + 1))
    return turn / np.prod(list(parts), axis=0)


def _measure_bend(h: Array, upper: Array, lower: Array) -> tuple[Array, tuple[Array, Array]]:
    """Measure the sine (m,) of the turn about h between two links, and their lengths (m,)."""
    upper, lower = (v - h * np.einsum("mi,mi->m", v, h)[:, None] for v in (upper, lower))
    lengths = np.linalg.norm(upper, axis=1), np.linalg.norm(lower, axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.einsum("mi,mi->m", h, np.cross(upper, lower)) / (lengths[0] * lengths[1]), lengths


def _measure_seven_turns(
    h: Array, o: Array
) -> tuple[tuple[Array, Array, Array], tuple[Array, Array]]:
    """Measure shoulder, elbow and wrist (m,) of an arm of seven turns, and its link lengths (m,).

    Sines of the turns of joints 2, 4 and 6 from where the arm is stretched (Shimizu and others,
    2008, equation 4).
    """
    shoulder = _find_centre(h, o, 0)
    wrist = _find_centre(h, o)
    bend, lengths = _measure_bend(h[:, 3], o[:, 3] - shoulder, wrist - o[:, 3])
    return (_measure_middle_turn(h, 0), bend, _measure_middle_turn(h, 4)), lengths


def _compute_branch_measures(
    kind: Kind, h: Array, o: Array
) -> tuple[tuple[Array, Array, Array], tuple[Array, Array]]:
    """Compute signed measures (m,) of shoulder, elbow and wrist, and lengths (m,) of the links.

    The elbow is that of the plane across axis 2, seen from the side to which axis 2 points.
    """
    centre = _find_centre(h, o)
    bend, lengths = _measure_bend(
        h[:, 1], o[:, 2] - o[:, 1], (o[:, 3] if kind.three_parallel else centre) - o[:, 2]
    )
    return (_measure_shoulder(h, o, centre), -bend, _measure_middle_turn(h, 3)), lengths
