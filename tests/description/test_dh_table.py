"""Denavit-Hartenberg tables in all the forms in which people have them: the same chain, or a
reason.
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
import reference

import kempe
from kempe import spatial
from kempe.description.dh import ORDER, DHRow, from_dh
from kempe.description.toml_reader import read_toml
from kempe.errors import DescriptionError, InputError

Row = namedtuple("Row", ("theta", "d", "a", "alpha"))


class Frame:
    """What a DataFrame shows of itself: column names, and columns by name."""

    def __init__(self, columns: dict[str, Sequence[Any]]):
        self._data = columns
        self.columns = list(columns)

    def __getitem__(self, name: str) -> np.ndarray:
        return np.array(self._data[name])


TABLE = [(0.1, 0.5, 0.3, -0.4), (0.5, -1.5, 0.0, 0.2), (0.0, 0.3, 0.25, 0.0)]
BY_NAME = {name: [row[i] for row in TABLE] for i, name in enumerate(ORDER)}
FORMS: dict[str, Any] = {
    "tuples": TABLE,
    "lists": [list(row) for row in TABLE],
    "array": np.array(TABLE),
    "array of long doubles": np.array(TABLE, dtype=np.longdouble).astype(float),
    "list of arrays": [np.array(row) for row in TABLE],
    "rows of DHRow": [DHRow(*row) for row in TABLE],
    "dicts": [dict(zip(ORDER, row, strict=True)) for row in TABLE],
    "dict of lists": BY_NAME,
    "columns in capitals": {name.upper(): column for name, column in BY_NAME.items()},
    "columns in another order": dict(reversed(BY_NAME.items())),
    "structured array": np.array(TABLE, dtype=[(name, float) for name in ORDER]),
    "data frame": Frame(BY_NAME),
    "named tuples": [Row(theta, d, a, alpha) for a, alpha, d, theta in TABLE],
    "records": list(np.array(TABLE, dtype=[(name, float) for name in ORDER])),
    "generator": (row for row in TABLE),
    "with types": [(*row, "revolute") for row in TABLE],
}


@pytest.mark.parametrize("form", list(FORMS))
def test_forms_of_one_table(form: str):
    assert from_dh(FORMS[form]) == from_dh([DHRow(*row) for row in TABLE])


def test_the_order_of_plain_rows_is_noted():
    assert from_dh(TABLE).notes == ["plain rows of the table were read as a, alpha, d, theta"]
    assert from_dh(BY_NAME).notes == from_dh(FORMS["dicts"]).notes == []


def test_pandas_and_polars():
    for library in ("pandas", "polars"):
        module = pytest.importorskip(library)
        table = {**BY_NAME, "type": ["revolute", None, "prismatic"], "name": ["A", "B", "C"]}
        m = from_dh(module.DataFrame(table))
        assert [j.type.type_name for j in m.joints.values()] == [
            "revolute",
            "revolute",
            "prismatic",
        ]
        assert list(m.joints) == ["A", "B", "C"]


def test_rows_of_pandas():
    table = pytest.importorskip("pandas").DataFrame(dict(reversed(BY_NAME.items())))
    wanted = from_dh(TABLE)
    assert (
        from_dh(table.itertuples(index=False))
        == from_dh([row for _, row in table.iterrows()])
        == wanted
    )
    with pytest.raises(InputError, match="row 1 has an unknown entry 'Index'"):
        from_dh(table.itertuples())


def test_what_is_missing_in_a_table_is_left_out():
    m = from_dh(
        {
            "a": [0.1, 0.2],
            "limits": [(-1, 1), float("nan")],
            "type": [None, "prismatic"],
            "name": ["A", None],
        }
    )
    assert (
        list(m.joints) == ["A", "q2"]
        and m.joints["q2"].limits == {}
        and m.joints["A"].limits == {"": (-1.0, 1.0)}
    )
    with pytest.raises(InputError, match="row 2: a is nan; it must be finite"):
        from_dh({"a": [0.1, float("nan")], "d": [0, 0]})


@pytest.mark.parametrize("x", [6.68283349819805572, -6.4421, 12.2, -11.93, 13.4, -19.2731, 57.12])
def test_calibrated_angles_may_be_beyond_a_turn(x):
    """Controllers count turns: an offset, or theta, of more than one is an angle in radians."""
    within = x - 2.0 * np.pi * np.round(x / (2.0 * np.pi))
    for name in ("offset", "theta"):
        here, same = (
            from_dh([{"a": 0.3, "d": 0.1, "alpha": 0.2, name: y}]).build() for y in (x, within)
        )
        q = np.linspace(-3.0, 3.0, 7)[:, None]
        np.testing.assert_allclose(here.fk(q, "tool"), same.fk(q, "tool"), atol=1e-14)


def test_a_table_of_radians_may_have_several_angles_beyond_a_turn():
    """A calibrated arm with fixed twists: some joints were turned more than once before they were
    measured.
    """
    alpha = [0.01, np.pi / 2, 0.02, -np.pi / 2]
    theta = [13.4, 0.2, 6.6828, -12.71]
    rows = [
        {"a": 0.3, "alpha": x, "theta": y, "type": "fixed"}
        for x, y in zip(alpha, theta, strict=True)
    ]
    # three of six, as in degrees
    with pytest.raises(InputError, match="row 1: theta is 13.4, .* deg=True"):
        from_dh([{"theta": y} for y in theta])
    here = from_dh([*rows, {}]).build()
    same = from_dh(
        [*({**row, "theta": float(np.angle(np.exp(1j * row["theta"])))} for row in rows), {}]
    ).build()
    np.testing.assert_allclose(here.fk([0.3], "tool"), same.fk([0.3], "tool"), atol=1e-13)


def test_hunt_tables_in_the_wrong_unit_are_refused_and_calibrated_ones_are_read(hunt):
    """Arms with five to seven joints: in degrees, rounded or measured, and in radians with turns
    counted.
    """
    rng = hunt.rng()
    quarter = np.array([0.0, 90.0, -90.0, 180.0])
    for _ in range(hunt.cases(1000)):
        n = int(rng.integers(5, 8))
        noise = rng.normal(size=(2, n)) * (0.05 if rng.random() < 0.7 else 0.0)
        planar = rng.random() < 0.5
        alpha = (
            noise[0] if planar else np.array([90.0, 90.0, *rng.choice(quarter, n - 2)]) + noise[0]
        )
        offset = rng.uniform(-180.0, 180.0, n) if planar else rng.choice(quarter, n) + noise[1]
        rows = [
            {"a": 0.2, "alpha": float(x), "offset": float(y)}
            for x, y in zip(alpha, offset, strict=True)
        ]
        with pytest.raises(InputError, match="deg=True"):
            from_dh(rows)
        from_dh(rows, deg=True)
        turns = (
            np.where(rng.permutation(n) < rng.integers(1, 3), rng.integers(-2, 3, n), 0)
            * 2.0
            * np.pi
        )
        radians = np.deg2rad([alpha, offset])
        radians[1] += turns
        from_dh([{"a": 0.2, "alpha": float(x), "offset": float(y)} for x, y in radians.T])


def test_columns_name_another_order():
    corke = [(theta, d, a, alpha) for a, alpha, d, theta in TABLE]
    m = from_dh(corke, columns=("theta", "d", "a", "alpha"))
    assert m == from_dh(TABLE) and m.notes == [
        "plain rows of the table were read as theta, d, a, alpha"
    ]
    assert from_dh([("A", 0.5)], columns=("name", "a")) == from_dh([{"name": "A", "a": 0.5}])


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (
            lambda: from_dh([(0, 90, 0.4, 0)]),
            "row 1: alpha is 90, which is 14.3 turns in radians; .*deg=True",
        ),
        (lambda: from_dh([(0, 0, 0.4, 0), (0, 0, 0, -180)]), "row 2: theta is -180, .* deg=True"),
        (lambda: from_dh([{"offset": 45}]), "row 1: offset is 45, .* deg=True"),
        (
            lambda: from_dh([{"offset": 7.5}]),
            "offset is 7.5, .* deg=True; .* the same angle is 1.21681",
        ),
        (
            lambda: from_dh([{"offset": 90.123}]),
            "offset is 90.123, .* deg=True; .* the same angle is 2.15840",
        ),
        (
            lambda: from_dh([{"alpha": 6.6828}]),
            "alpha is 6.6828, .* deg=True; .* the same angle is 0.399614",
        ),
        (lambda: from_dh([{"limits": (-170, 170)}]), "row 1: limits hold -170, .* deg=True"),
        (
            lambda: from_dh([(0, np.pi / 2, 0.4, 0)], deg=True),
            "alpha is 1.5708 with deg=True.* 90 degrees: leave",
        ),
        (lambda: from_dh([{"theta": -3.14159265}], deg=True), "theta is -3.14159 with deg=True"),
        (lambda: from_dh([{"alpha": "pi/2"}], deg=True), "alpha is 'pi/2' with deg=True"),
        (lambda: from_dh([(0, 0, 0, 0)], deg=1), "deg is 1; it must be True or False"),
        (lambda: from_dh([{"flip": 1}]), "flip is 1; it must be True or False"),
        (
            lambda: from_dh([{"type": "fixed", "flip": True}]),
            "a fixed row has no offset and is not flipped",
        ),
        (
            lambda: from_dh([(1, 2, 3)]),
            "row 1 has 3 entries; it must have a, alpha, d, theta, and the type",
        ),
        (
            lambda: from_dh([(1, 2)], columns=("a", "d", "alpha")),
            "row 1 has 2 entries; it must have a, d, alpha$",
        ),
        (
            lambda: from_dh([(1, 2)], columns=("a", "r")),
            "columns hold 'r', which a row does not have",
        ),
        (lambda: from_dh([(1, 2)], columns=("a", "a")), "a name appears twice"),
        (lambda: from_dh([(1, 2)], columns="ad"), "columns are 'ad'"),
        (lambda: from_dh({"a": [1, 2], "d": [1]}), "different lengths: 2 of 'a', 1 of 'd'"),
        (lambda: from_dh({"a": 1.0}), "column 'a' is 1.0; it must have an entry for each row"),
        (lambda: from_dh({"a": [1], "r": [2]}), "unknown column 'r'"),
        (lambda: from_dh({"a": [1], "A": [2]}), "a name appears twice"),
        (lambda: from_dh({"a": [1]}, columns=("d",)), "the table names its own"),
        (
            lambda: from_dh([{"a": 1}], columns=("d",)),
            "the rows name their entries; leave columns out",
        ),
        (lambda: from_dh("abcd"), "they must be a list of rows"),
        (lambda: from_dh(5), "they must be a list of rows"),
        (lambda: from_dh(np.zeros(4)), "row 1 is .*plain numbers or a dict"),
        (lambda: from_dh(np.zeros((0, 4))), "no rows"),
        (lambda: from_dh([("x y", 0, 0, 0)]), "row 1: a: .*not an expression|not an expression"),
    ],
)
def test_what_is_wrong(call: Callable[[], object], words: str):
    with pytest.raises(InputError, match=words):
        call()


def test_one_turn_and_less_is_an_angle():
    turns = from_dh([(0, 2 * np.pi, 0, -2 * np.pi), (0, 6.28319, 0, 3.0)]).build()
    np.testing.assert_allclose(
        turns.fk([0.0, 0.0], "tool"), spatial.pose(spatial.rot_z(3.0), [0, 0, 0]), atol=1e-5
    )
    degrees = from_dh([(0, 90, 0, 0), (0, 1.5, 0, 359.9)], deg=True).build()
    R = spatial.rot_x(np.pi / 2) @ spatial.rot_z(np.deg2rad(-0.1)) @ spatial.rot_x(np.deg2rad(1.5))
    np.testing.assert_allclose(
        degrees.fk([0.0, 0.0], "tool"), spatial.pose(R, [0, 0, 0]), atol=1e-12
    )
    wide = from_dh(
        [{"limits": (-9 * np.pi, 9 * np.pi)}, {"type": "prismatic", "limits": (0, 400.0), "d": 90}]
    ).build()
    assert wide.lower.tolist() == [-9 * np.pi, 0.0] and wide.upper.tolist() == [9 * np.pi, 400.0]


def test_degrees_are_those_of_turning_joints():
    rows = [
        {"alpha": 90, "theta": "t", "limits": (-170, None), "velocity": 180},
        {
            "type": "prismatic",
            "theta": 90,
            "d": 1.5,
            "limits": (0, 90),
            "velocity": 2.0,
            "offset": 30,
        },
    ]
    m = from_dh(rows, deg=True, parameters={"t": 45.0})
    assert m.joints["q1"].limits == {"": (np.deg2rad(-170), np.inf)} and m.joints["q2"].limits == {
        "": (0.0, 90.0)
    }
    assert m.joints["q1"].velocity_limits == {"": np.pi} and m.joints["q2"].velocity_limits == {
        "": 2.0
    }
    X = (turn_z(45) @ turn_x(90) @ turn_z(90) @ reference.slide("z", 31.5)).astype(float)
    np.testing.assert_allclose(m.build().fk([0, 0], "tool"), X, rtol=0, atol=1e-14)


def turn_z(degrees: float) -> np.ndarray:
    return reference.turn("z", np.deg2rad(degrees))


def turn_x(degrees: float) -> np.ndarray:
    return reference.turn("x", np.deg2rad(degrees))


def test_tables_of_files():
    text = 'format = 1\n[dh]\ndeg = true\ncolumns = ["theta", "d", "a", "alpha"]\n'
    text += "rows = [[30, 0.4, 0, 90], [0, 0, 0.5, 0]]\n"
    m = read_toml(text)
    assert m == from_dh([(0, 90, 0.4, 30), (0.5, 0, 0, 0)], deg=True, name="mechanism")
    assert m.notes == ["plain rows of the table were read as theta, d, a, alpha"]
    with pytest.raises(DescriptionError, match=r"<text>:5: dh: row 1: alpha is 90, which is"):
        read_toml(text.replace("deg = true", "deg = false"))


# ---- an arm of roboticstoolbox with a flipped joint

JACO = [(0, 90, 0.2755, 0), (0.41, 180, 0, -90), (0, 90, -0.0098, 90), (0, 60, -0.2501971250007892, 0),
        (0, 60, -0.08579425000157839, -180), (0, 180, -0.2115971250007892, 100)]  # fmt: skip
"""a [m], alpha [degrees], d [m], offset [degrees] of a Jaco of Kinova; its first joint is
flipped."""


def test_a_flipped_joint_of_a_jaco():
    # without the flip: another arm
    s = from_dh(JACO, deg=True, columns=("a", "alpha", "d", "offset"))
    rows = [dict(zip(("a", "alpha", "d", "offset"), row, strict=True)) for row in JACO]
    flipped = from_dh([{**rows[0], "flip": True}, *rows[1:]], deg=True)
    q = [0.1, -0.2, 0.3, -0.4, 0.5, -0.6]
    # by fkine of roboticstoolbox 1.5
    found = [
        [0.423625328060017, 0.903127810034392, 0.070012428671816, 0.054170590947179],
        [-0.895135056808621, 0.429213901738362, -0.120451885110858, 0.029493172328686],
        [-0.138833754895093, -0.011644109970921, 0.990247243472414, 0.354292170054356],
    ]
    np.testing.assert_allclose(flipped.build().fk(q, "tool")[:3], found, rtol=0, atol=1e-14)
    assert np.abs(s.build().fk(q, "tool")[:3] - found).max() > 0.1
    assert from_dh(rows, deg=True) == s


# ---- the hunt


def drawn(
    rng: np.random.Generator,
) -> tuple[list[dict[str, Any]], bool, str, dict[str, float], np.ndarray]:
    """Rows by name, whether in degrees, the convention, a configuration by name, and the pose by
    plain matrices.
    """
    deg = bool(rng.random() < 0.5)
    standard = bool(rng.random() < 0.5)
    rows = []
    q = {}
    X = np.eye(4)
    unit = np.pi / 180.0 if deg else 1.0
    for i in range(int(rng.integers(1, 7))):
        kind = str(rng.choice(["revolute", "revolute", "prismatic", "fixed"]))
        a, d = rng.uniform(-1, 1, 2).round(3).tolist()
        angles = (
            rng.choice([-180, -90, 0, 0, 90, 30, -45.5], 2) if deg else rng.uniform(-3.1, 3.1, 2)
        )
        alpha, theta = (float(x) for x in angles)
        row: dict[str, Any] = {"a": a, "alpha": alpha, "d": d, "theta": theta, "type": kind}
        sign = 1.0
        value = float(rng.uniform(-3, 3))
        turns = kind == "revolute"
        offset = 0.0
        if kind != "fixed":
            q[f"q{i + 1}"] = value
            if rng.random() < 0.4:
                row["flip"] = True
                sign = -1.0
            if rng.random() < 0.4:
                offset = (
                    float(rng.choice([90, -30, 12.5]))
                    if deg and turns
                    else float(rng.uniform(-1, 1))
                )
                row["offset"] = offset
        angle = unit * (theta + offset * turns) + sign * value * turns
        length = d + (offset + sign * value) * (kind == "prismatic")
        z = reference.turn("z", angle) @ reference.slide("z", length)
        x = reference.slide("x", a) @ reference.turn("x", unit * alpha)
        X = X @ (z @ x if standard else x @ z).astype(float)
        rows.append(row)
    return rows, deg, "standard" if standard else "modified", q, X


def written(rng: np.random.Generator, rows: list[dict[str, Any]]) -> tuple[Any, dict[str, Any]]:
    """The table in one of its forms, and the keywords that go with it."""
    names = [
        str(n) for n in rng.permutation(["a", "alpha", "d", "theta", "type", "flip", "offset"])
    ]
    usual: dict[str, Any] = {"flip": False, "offset": 0.0}
    full = [[row.get(n, usual.get(n)) for n in names] for row in rows]
    how = int(rng.integers(5))
    if how == 0:
        return rows, {}
    if how == 1:
        return [DHRow(**row) for row in rows], {}
    if how == 2:
        return [tuple(row) for row in full], {"columns": names}
    columns: dict[str, list[Any]] = {n: [row[i] for row in full] for i, n in enumerate(names)}
    return (columns, {}) if how == 3 else (Frame(columns), {})


def hunted(rng: np.random.Generator, count: int) -> None:
    for _ in range(count):
        rows, deg, convention, q, X = drawn(rng)
        table, keywords = written(rng, rows)
        s = from_dh(table, convention, deg=deg, **keywords).build()
        np.testing.assert_allclose(
            s.fk(q if s.nq else [], "tool"), X, rtol=0, atol=1e-12, err_msg=str(table)
        )


def test_tables_are_read_as_the_books_write_them(hunt):
    hunted(hunt.rng(), hunt.cases(100))


@pytest.mark.slow
def test_many_tables_are_read_as_the_books_write_them(hunt):
    hunted(hunt.rng(), hunt.cases(1000))


def test_the_first_arm_of_a_newcomer():
    arm = kempe.from_dh(
        [(0, 90, 0.0892, 0), (-0.425, 0, 0, 0), (-0.392, 0, 0, 0)], deg=True
    ).build()
    assert arm.fk([0, 0, 0], "tool")[0, 3] == pytest.approx(-0.817, abs=1e-15)
