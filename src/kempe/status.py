"""Outcomes of all solvers as one enumeration, each with a sentence."""

from __future__ import annotations

from enum import IntEnum
from typing import Any

import numpy as np


class Status(IntEnum):
    """Outcome of a question, as `code` of its answer.

    Attributes
    ----------
    sentence
        The outcome in words; `status` of an answer says more of the answer at hand.
    proof
        Whether the outcome is proved: there is no solution.

    Notes
    -----
    Only `SOLVED` is false as a truth value: compare (``answer.code is Status.SOLVED``), or ask the
    answer itself. The `code` of a batch is an array of numbers; ``Status(number)`` is the member.

    Examples
    --------
    >>> Status.OUT_OF_REACH.sentence
    'outside of what the lengths of the links reach'
    >>> [s.name for s in Status if s.proof]
    ['OUT_OF_REACH', 'CONTRADICTORY', 'OUTSIDE_LIMITS', 'NONE_EXISTS']
    """

    sentence: str
    proof: bool

    SOLVED = 0, "what was requested is found"
    NOT_FOUND = 1, "not found; that is no proof that there is none"
    BAD_INPUT = (
        2,
        "the input has numbers that are not finite or too large, or a matrix that is not a pose",
    )
    OUT_OF_REACH = 3, "outside of what the lengths of the links reach", True
    OUT_OF_TIME = 4, "not found within the time limit"
    CONTRADICTORY = 5, "two things that are requested exclude each other", True
    OUTSIDE_LIMITS = (
        6,
        "excluded by limits: a given value, or whatever answers, is outside of them",
        True,
    )
    NONE_EXISTS = (
        7,
        "there is no configuration that does what is required, with or without limits",
        True,
    )
    OTHER_BRANCH = 8, "the branch requested cannot be closed; the answer is on another one"
    PARTLY = 9, "only a part of what was requested is had; the rest is not found, or cannot be"
    INTERRUPTED = 10, "interrupted from the keyboard; this is the part that was done"
    DEAD_POINT = 11, "a dead point: the inputs cannot move independently"
    UNDETERMINED = 12, "what was requested is not determined by what was given"
    TOO_NEAR = 13, "bodies come nearer to one another than clearances allow"

    def __new__(cls, value: int, sentence: str, proof: bool = False) -> Status:
        """Make the member with this number and sentence."""
        out = int.__new__(cls, value)
        out._value_ = value
        out.sentence = sentence
        out.proof = proof
        return out

    def __str__(self) -> str:
        return self.name


MEMBERS = tuple(Status)
"""The members by their numbers: looking one up here takes a fraction of the time of
``Status(number)``."""
PROOFS = tuple(s for s in MEMBERS if s.proof)
"""Outcomes that prove that there is no answer."""


def to_status(code: Any) -> Any:
    """Convert one number to its `Status`; the numbers (...) of a batch are returned as they are."""
    return MEMBERS[code] if type(code) is int else code if np.ndim(code) else MEMBERS[int(code)]


def name_outcomes(code: Any) -> Any:
    """Return the name of one outcome, or nested lists of names for a batch."""
    return [name_outcomes(x) for x in code] if np.ndim(code) else MEMBERS[int(code)].name
