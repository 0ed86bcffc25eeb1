"""Every kind of constraint does what kinds do, and needs no other kind; no name of a kind stands
outside its table.
"""

from __future__ import annotations

import ast
import subprocess
import sys
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
import sources
from hunts import part
from kinds_battery import EXAMPLES, run, two_bodies
from scipy.spatial.transform import Rotation

from kempe import constraints as c
from kempe.constraints import KINDS
from kempe.constraints.base import Constraint, kind, make_content_key
from kempe.constraints.clearances import Apart
from kempe.equations.tasks import Task
from kempe.errors import InputError

HERE = Path(__file__).parent
SOURCE = HERE.parents[1] / "src" / "kempe"
ALLOWED = {p.relative_to(SOURCE).as_posix() for p in (SOURCE / "constraints").rglob("*.py")}
ALLOWED |= {"description/mechanism.py", "answers/targets.py"}
"""The kinds themselves, and where they have names of another vocabulary: methods of the builder, tasks
of targets."""


def test_every_kind_has_an_example():
    assert set(EXAMPLES) <= set(KINDS)
    shapes = {k for k, kind in KINDS.items() if issubclass(kind, Apart)}  # they have no rows
    own = {k for k, kind in KINDS.items() if kind.__module__.startswith("kempe.")}
    assert own - shapes == set(EXAMPLES) and shapes == {"clearance"}


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("name", EXAMPLES)
def test_what_holds_for_every_kind(name, dim):
    run(name, dim)


WITHOUT = """
import sys
sys.path.insert(0, {here!r})
from kempe.constraints import KINDS
from kempe.constraints.base import Constraint, kind
from kempe.errors import InputError
del KINDS[{name!r}]
import kinds_battery
for other in kinds_battery.EXAMPLES:
    if other != {name!r}:
        kinds_battery.run(other, 3)
"""


@pytest.mark.slow
@pytest.mark.parametrize("name", part(EXAMPLES))
def test_no_kind_needs_another(name):
    script = WITHOUT.format(here=str(HERE), name=name)
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]


@sources.each(
    [p for p in SOURCE.rglob("*.py") if p.relative_to(SOURCE).as_posix() not in ALLOWED], SOURCE
)
def test_kinds_are_named_in_their_table_only(path):
    """Everywhere else what is to be done follows from their rows."""
    classes = {kind.__name__ for kind in KINDS.values()} - {"Function"}
    for node in sources.nodes(path):
        if (
            isinstance(node, ast.ImportFrom)
            and node.module
            and node.module.startswith("kempe.constraints")
        ):
            assert not classes & {alias.name for alias in node.names}, f"line {node.lineno}"
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            assert not (node.value.id in ("constraints", "tasks") and node.attr in classes), (
                f"line {node.lineno}"
            )
        if isinstance(node, ast.Compare):
            names = {
                x.value
                for x in ast.walk(node)
                if isinstance(x, ast.Constant) and isinstance(x.value, str)
            }
            kinds = any(isinstance(x, ast.Attribute) and x.attr == "kind" for x in ast.walk(node))
            assert not (
                kinds and names & (set(KINDS) - {"joint"}) and "constraint" in ast.unparse(node)
            ), f"line {node.lineno}"


SWITCHES = [(name, f.name) for name in EXAMPLES for f in fields(KINDS[name]) if f.type == "bool"]


@pytest.mark.parametrize("given", [None, 1, "no", np.zeros((3, 3)), slice(None)], ids=repr)
@pytest.mark.parametrize(("name", "switch"), SWITCHES, ids=["-".join(x) for x in SWITCHES])
def test_a_switch_is_true_or_false(name, switch, given):
    made = EXAMPLES[name](3)
    with pytest.raises(InputError, match=f"{switch} of .* is .*; it must be True or False"):
        replace(made, **{switch: given})


def test_a_kind_whose_fields_are_not_written_as_text_is_refused():
    """What a field is, such as a frame, is read from its annotation."""
    made = type(
        "Odd", (Constraint,), {"__annotations__": {"frame": object}, "rows": lambda self, dim: ()}
    )
    with pytest.raises(
        InputError, match="Odd: its module must begin with: from __future__ import annotations"
    ):
        kind("odd")(made)
    assert "odd" not in KINDS


def test_what_may_be_left_out_is_given_by_name_only_and_parameters_are_not_shown():
    made = [EXAMPLES[name](3) for name in EXAMPLES]
    late = {
        (m.kind, f.name)
        for m in made
        if m.list_rows(3)
        for f in fields(m)
        if f.default is None
        and not f.kw_only
        and f.name in ("other", "parameters", "at_least", "at_most", "name")
    }
    assert late == {(name, "other") for name in ("contact", "no_sideslip", "rolls")}
    assert not [m.kind for m in made if "parameters=" in repr(m)]


def test_the_content_of_a_constraint_is_its_kind_and_what_it_says_but_not_the_parameters_of_a_mechanism():
    made = c.Equation("A - 2*B")
    assert make_content_key(made)[0] == "equation" and (
        "expression",
        "A - 2*B",
    ) in make_content_key(made)
    assert (
        make_content_key(made)
        == make_content_key(replace(made, parameters=("p",)))
        != make_content_key(c.Equation("A - 3*B"))
    )


@pytest.mark.parametrize(
    ("name", "label"),
    [
        ("centre_of_points", "CentreOfPoints of 'tip', 'eye'"),
        ("centre_of_mass", "CentreOfMass of the system"),
        ("distance", "Distance of 'tip' and 'eye'"),
        ("position", "Position of 'tip'"),
    ],
)
def test_messages_name_what_a_constraint_is_about(name, label):
    assert EXAMPLES[name](3).label == label


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("name", [name for name in EXAMPLES if KINDS[name].goals])
def test_only_the_goal_depends_on_what_is_declared_to_be_one(dim, name):
    """A task copied with another goal is the one that would be made anew."""
    system = two_bodies(dim).build()
    rng = np.random.default_rng(2)
    made = EXAMPLES[name](dim)
    first = Task(system, made)
    key, pose = first.structure_key, first.goal.pose
    (field,) = made.goals
    given = np.array(getattr(made, field), dtype=float)
    for _ in range(10):
        if given.ndim == 2:
            turn = Rotation.from_rotvec(rng.normal(size=3) * ((0, 0, 1) if dim == 2 else 1))
            new = np.eye(len(given))
            new[: len(given) - 1, -1] = rng.normal(size=len(given) - 1)
            rotation = slice(3 if name == "orientation" else dim)
            new[rotation, rotation] = turn.as_matrix()[rotation, rotation]
        else:
            new = rng.normal(size=given.shape)
        other = replace(made, **{field: new})
        copied = first.copy_with_goal(other)
        anew = Task(system, other)
        assert copied.structure is first.structure and copied.structure_key == key
        assert anew.structure_key == key and anew.structure is not first.structure
        assert np.array_equal(copied.goal.pose, anew.goal.pose)
        assert not np.array_equal(copied.goal.pose, pose)
        q = system.random(rng, 5)
        for a, b in zip(copied.measure_error(q), anew.measure_error(q), strict=True):
            assert np.array_equal(a, b)
