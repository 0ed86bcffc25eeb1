"""Sentences that are made of numbers and words agree: over all shipped models, no "1 joints", no "1
... are".
"""

from __future__ import annotations

import ast
import itertools
import re
from pathlib import Path

import numpy as np
import pytest
import sources
from closed_graphs import random_closed
from hunts import some

import kempe
from kempe.errors import KempeError
from kempe.library import list_models as library_models
from kempe.views.facts import SystemFacts
from kempe.views.overviews import list_tree_lines
from kempe.words import choose_verb, format_count, format_share, make_plural, spell_count

SOURCE = Path(kempe.__file__).parent

NOT_PLURAL = """
    across always as axis bus closes does gives has holds is its leads leaves less lies locus means meets moves needs
    passes plus radius spins takes this turns was yes
""".split()
"""Words that end in s and may follow a one."""

STOP = {*NOT_PLURAL, *"of to at by in from for and or with per x inside here that which".split()}
"""Words at which a noun has ended."""

ONE = re.compile(r"(?<![\w.,/()+*=-])(?:1|[Oo]ne) ([a-z]+(?:[ -][a-z]+){0,2})")
VERBS = re.compile(
    r"\b(?:are|were|have) (?:1|one) [a-z]|(?<![\d.])\b(?:1|one) [a-z]+ (?:are|were|have)\b"
)


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
        ("1 joints", True),
        ("1 joint", False),
        ("here 1 different ones are independent", True),
        ("2 of 1 targets reached", True),
        ("Taken away are 1 prismatic joint", True),
        ("1 is less", False),
        ("of 11 joints", False),
        ("0.1 metres", False),
        ("1 degree of freedom", False),
        ("1 class", False),
        ("1 independent coordinates: A", True),
        ("one more closes a loop", False),
        ("1 of its freedoms are", False),
    ],
)
def test_the_hunter_notices(text, bad):
    assert bool(wrong(text)) is bad


def test_words_agree():
    assert [format_count(n, "planar joint") for n in (0, 1, 2)] == [
        "0 planar joints",
        "1 planar joint",
        "2 planar joints",
    ]
    assert (format_count(2, "body"), make_plural(1, "body"), spell_count(2, "axis")) == (
        "2 bodies",
        "body",
        "two axes",
    )
    assert (choose_verb(1, "is", "are"), choose_verb(0, "is", "are")) == ("is", "are")
    assert (
        format_share(1, 1, "targets reached") == "1 of 1 target reached"
        and format_share(0, 2, "closed") == "0 of 2 closed"
    )


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


@pytest.mark.parametrize("name", some(MODELS, 3))
def test_sentences_of_shipped_models_agree(name):
    system = kempe.load(name)
    names = system.coordinate_names
    tip = system.frame_names[-1]
    q = system.random(0)
    calls = [
        lambda: system,
        lambda: system.structure,
        lambda: system.configuration_space,
        lambda: system.configuration_space.parametrizations(),
        lambda: system.mobility(actuated=names[:1]),
        lambda: system.mobility(local=False).relative(system.body_names[-1], system.body_names[0]),
        system.independent,
        lambda: system.independent(prefer=list(names)),
        lambda: SystemFacts(system),
        lambda: "\n".join(list_tree_lines(system)),
        lambda: system.fk(np.zeros(1), tip),
        lambda: "\n".join(j.forbids(system.dim) for j in system.structure.joints.values()),
        lambda: system.assemble(dict.fromkeys(names, 0.1)),
        system.assemble,
        lambda: system.open_loops(),
    ]
    if names:
        calls += [
            lambda: system.independent(prefer=names[:1]),
            lambda: system.loops.closed_form(names[:1]),
            lambda: system.loops.closed_form([]),
        ]
    if not system.structure.closures:
        X = system.fk(np.stack([q]), tip)
        far = np.eye(4)
        far[0, 3] = 50.0
        calls += [
            lambda: system.inverse.plan(tip),
            lambda: system.ik_all(X[0], tip),
            lambda: system.ik_all(X, tip),
            lambda: system.ik(X[0], tip),
            lambda: system.ik(X, tip),
            lambda: system.ik_path(X, tip),
            lambda: system.ik(far, tip, budget=kempe.Budget(starts=2)),
            lambda: system.ik_all(far, tip),
            lambda: system.task_space(tip),
        ]
    text = "\n".join(map(said, calls))
    assert wrong(text) == []


def about(system: kempe.System) -> str:
    """What Kempe says about a mechanism, quickly."""
    names = system.coordinate_names
    tip = system.frame_names[-1]
    assemble = system.assemble
    calls = [
        lambda: system,
        lambda: system.structure,
        lambda: system.configuration_space,
        lambda: system.configuration_space.parametrizations(),
        lambda: system.mobility(local=False),
        lambda: "\n".join(system.mobility(local=False).counting.steps),
        lambda: system.loops.closed_form(names[:1]),
        lambda: system.mobility(actuated=names[:1], local=False),
        system.independent,
        system.classify,
        lambda: system.independent(prefer=names[:2]),
        lambda: SystemFacts(system),
        lambda: "\n".join(list_tree_lines(system)),
        lambda: system.task_space(tip),
        system.open_loops,
        assemble,
        lambda: assemble(dict.fromkeys(names, 0.1)),
        lambda: assemble({names[0]: np.array([0.1])}),
        lambda: system.ik(np.eye(4), tip, budget=FEW),
        lambda: "\n".join(j.forbids(system.dim) for j in system.structure.joints.values()),
    ]
    return "\n".join(map(said, calls))


@pytest.mark.parametrize("most", [16, pytest.param(400, marks=pytest.mark.slow)])
def test_sentences_of_random_mechanisms_agree(most, hunt):
    """Random mechanisms with one to three loops; a hundred of them in the long run."""
    rng = hunt.rng()
    for case in range(hunt.cases(most)):
        assert wrong(about(random_closed(rng).system())) == [], f"case {case}"


FEW = kempe.Budget(starts=1)


@pytest.mark.parametrize(
    "call",
    [
        lambda: kempe.from_dh([(1,)]),
        lambda: kempe.constraints.Equation("atan2(x)", of="x"),
        lambda: kempe.load("two_link").fk([0.1], "e"),
        lambda: kempe.load("slider").fk([0.1, 0.2], "B5"),
        lambda: kempe.load("two_link").inverse.arm_angle([0.1, 0.2], "e"),
        lambda: kempe.load("two_link").ik([0.6], "e"),
        lambda: kempe.load("four_bar").loops.closed_form(["A"]).solve([0.1, 0.2]),
        lambda: kempe.load("two_link").task_space("e", task="pose"),
        lambda: kempe.load("slider").task_space("B5"),
        lambda: kempe.load("slider").independent(prefer=["J6", "J6"]),
        lambda: kempe.load("slider").singularities("B5", budget=FEW),
        lambda: kempe.load("two_link").workspace("e", n=1),
        lambda: kempe.load("four_bar").trace("A", budget=kempe.Budget(points=2)),
        lambda: kempe.load("two_link").inverse.self_motion([0.1, 0.2], "e", task="position"),
    ],
)
def test_sentences_about_one_thing_agree(call):
    assert wrong(said(call)) == []


AT_LEAST_TWO = (
    "joints lead to it",
    "links are nobody's child",
    "values; a coordinate has one",
    "characters; at most",
    "characters in all",
    "bodies with a joint to the ground beside it",
    "orientations",
    "events in all",
    "branches",
    "files",
    "joints; it may have",
    "other joints:",
    "signs of equality",
    "actuated coordinates depend",
    "joints are one",
    "shapes",
)
"""How texts go on after a number that is never one."""


def test_numbers_of_things_are_counted():
    """A text that puts a number before a plural says `format_count(n, "thing")`, unless the number
    is
    never one.
    """
    bare: list[str] = []
    for path in sorted(SOURCE.rglob("*.py")):
        for node in sources.nodes(path) if "{len(" in path.read_text(encoding="utf-8") else ():
            for number, text in itertools.pairwise(
                node.values if isinstance(node, ast.JoinedStr) else ()
            ):
                if isinstance(number, ast.FormattedValue) and isinstance(text, ast.Constant):
                    after = str(text.value).strip()
                    if ast.unparse(number.value).startswith("len(") and re.match(
                        r"(?:[a-z]+ )?[a-z]+s\b", after
                    ):
                        bare += [f"{path.name}: {after}"] * (not after.startswith(AT_LEAST_TWO))
    assert not bare
