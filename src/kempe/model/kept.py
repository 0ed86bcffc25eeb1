"""What follows from a system, and a few keys, alone is worked out once and kept with the system."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import TYPE_CHECKING, Any, Concatenate, ParamSpec, TypeVar

from kempe.budget import look

if TYPE_CHECKING:
    from kempe.model.compiled_system import SystemType

MOST = 256
"""Answers of one function that are kept with a system; the oldest go first."""

Keys = ParamSpec("Keys")
T = TypeVar("T")


def kept(
    function: Callable[Concatenate[SystemType, Keys], T],
) -> Callable[Concatenate[SystemType, Keys], T]:
    """A decorator for functions of a system and keys: an answer is kept, and returned again for
    equal arguments.

    Before an answer is worked out, the clock is looked at: of large systems it may take long.
    """

    @wraps(function)
    def call(system: SystemType, *keys: Any) -> T:
        answers = system._kept.get(function)
        if answers is None:
            answers = system._kept[function] = {}
        found = answers.get(keys, answers)  # it never holds itself
        if found is not answers:
            return found
        look()
        return keep(answers, keys, function(system, *keys))  # type: ignore[call-arg]

    return call  # type: ignore[return-value]


def keep(answers: dict[Any, Any], key: Any, answer: T, most: int = MOST) -> T:
    """The answer, kept under `key` in a store of at most `most` answers, where it replaces the
    oldest.
    """
    while len(answers) >= most:
        answers.pop(next(iter(list(answers)), None), None)
    answers[key] = answer
    return answer
