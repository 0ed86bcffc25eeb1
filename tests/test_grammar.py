"""Sentences that are made of numbers and words agree: over all shipped models, no "1 joints", no "1 ... are"."""

from __future__ import annotations

import re

import numpy as np
import pytest

import kempe
from kempe.errors import KempeError
from kempe.library import names as library_models
from kempe.views import report
from kempe.words import counted, in_words, of_many, plural, verb

NOT_PLURAL = """
    across always as axis bus closes does gives has holds is its leads leaves less lies locus means meets moves needs
    passes plus radius spins takes this turns was yes
""".split()
"""Words that end in s and may follow a one."""

STOP = {*NOT_PLURAL, *"of to at by in from for and or with per x inside here that which".split()}
"""Words at which a noun has ended."""

ONE = re.compile(r"(?<![\w.,/()+*=-])(?:1|[Oo]ne) ([a-z]+(?:[ -][a-z]+){0,2})")
VERBS = re.compile(r"\b(?:are|were|have) (?:1|one) [a-z]|(?<![\d.])\b(?:1|one) [a-z]+ (?:are|were|have)\b")


def wrong(text: str) -> list[str]:
    """What does not agree in a text."""
    out = [m[0] for m in VERBS.finditer(text)]
    for m in ONE.finditer(text):
        words = re.split("[ -]", m[1])
        noun = words[: next((k for k, word in enumerate(words) if word in STOP), len(words))]
        out += [m[0]] * any(word.endswith("s") and not word.endswith("ss") for word in noun)
    return out


@pytest.mark.parametrize(
    ("text", "bad"),
    [
        ("1 joints", True), ("1 joint", False), ("here 1 different ones are independent", True),
        ("2 of 1 targets reached", True), ("Taken away are 1 prismatic joint", True), ("1 is less", False),
        ("of 11 joints", False), ("0.1 metres", False), ("1 degree of freedom", False), ("1 class", False),
        ("1 independent coordinates: A", True), ("one more closes a loop", False), ("1 of its freedoms are", False),
    ],
)  # fmt: skip
def test_the_hunter_notices(text, bad):
    assert bool(wrong(text)) is bad


def test_words_agree():
    assert [counted(n, "planar joint") for n in (0, 1, 2)] == ["0 planar joints", "1 planar joint", "2 planar joints"]
    assert (counted(2, "body"), plural(1, "body"), in_words(2, "axis")) == ("2 bodies", "body", "two axes")
    assert (verb(1, "is", "are"), verb(0, "is", "are")) == ("is", "are")
    assert of_many(1, 1, "targets reached") == "1 of 1 target reached" and of_many(0, 2, "closed") == "0 of 2 closed"


def said(call) -> str:
    """What an answer prints, with its sentences, or what an error says."""
    try:
        answer = call()
    except KempeError as error:
        return str(error)
    status = np.ravel(np.asarray(getattr(answer, "status", ""), dtype=object))
    return "\n".join([str(answer), *map(str, status)])


LONG = {"double_watt", "wunderlich", "delta_uu", "three_upu_snu"}
MODELS = [pytest.param(n, marks=pytest.mark.slow) if n in LONG else n for n in library_models()]


@pytest.mark.parametrize("name", MODELS)
def test_sentences_of_shipped_models_agree(name):
    system = kempe.load(name)
    names, tip, q = system.coordinate_names, system.frame_names[-1], system.random(0)
    calls = [
        lambda: system, lambda: system.structure, lambda: system.configuration_space,
        lambda: system.configuration_space.parametrizations(), lambda: system.mobility(actuated=names[:1]),
        lambda: system.mobility(local=False).relative(system.body_names[-1], system.body_names[0]), system.independent,
        lambda: system.independent(prefer=list(names)), lambda: report.info(system, False), lambda: report.tree(system),
        lambda: system.fk(np.zeros(1), tip),
        lambda: "\n".join(j.forbids(system.dim) for j in system.structure.joints.values()),
        lambda: system.assemble(dict.fromkeys(names, 0.1)), system.assemble, lambda: system.opened(),
    ]  # fmt: skip
    if names:
        calls += [lambda: system.independent(prefer=names[:1]), lambda: system.loops.closed_form(names[:1]),
                  lambda: system.loops.closed_form([])]  # fmt: skip
    if not system.structure.closures:
        X = system.fk(np.stack([q]), tip)
        far = np.eye(4)
        far[0, 3] = 50.0
        calls += [
            lambda: system.inverse.plan(tip), lambda: system.ik_all(X[0], tip), lambda: system.ik_all(X, tip),
            lambda: system.ik(X[0], tip), lambda: system.ik(X, tip), lambda: system.ik_path(X, tip),
            lambda: system.ik(far, tip, budget=kempe.Budget(starts=2)), lambda: system.ik_all(far, tip),
            lambda: system.task_space(tip),
        ]  # fmt: skip
    text = "\n".join(map(said, calls))
    assert wrong(text) == []
