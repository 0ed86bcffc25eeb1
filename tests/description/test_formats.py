"""The table of formats: each row reads what it writes and refuses by name what it cannot say; a row
is all it takes.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from command import Result
from hunts import some
from own_format import ROWS
from shipped import shipped

import kempe
from kempe.description.dh import from_dh
from kempe.description.formats import DEFAULT, FORMATS, Format, join_titles, list_readable_formats
from kempe.description.mechanism import Mechanism
from kempe.description.read import check_description, read_mechanism
from kempe.errors import DescriptionError, InputError, KempeError, UnsupportedError
from kempe.joints import Revolute

WRITTEN = [name for name, f in FORMATS.items() if f.read and f.write]
OPTIONS = {
    "base": "free",
    "root": "ground",
    "model": "m",
    "lenient_limits": True,
    "package_dirs": ["meshes"],
}
READ_ONLY = {
    "mjcf": '<mujoco><worldbody><body name="a"><joint name="j"/></body></worldbody></mujoco>',
}
"""A hinge in formats that are read and not written."""


def hinge() -> Mechanism:
    m = Mechanism("m")
    m.revolute("j", m.ground, m.body("a"))
    return m


@pytest.fixture
def own(monkeypatch) -> Iterator[Format]:
    """The table of formats has the row of `own_format`, too, while a test runs."""
    monkeypatch.setitem(FORMATS, "rows", ROWS)
    yield ROWS


# ---- each row


def fits_urdf(m: Mechanism) -> bool:
    """Whether a model of the library has joints that lead to all bodies from the ground and that
    URDF has, and others that close loops as a <loop_joint>; none has locks or limits of several
    motions.
    """
    kinds = {"revolute", "prismatic", "fixed", "planar", "spherical", "free"}
    reached = {m.ground.name}
    for _ in m.bodies:
        reached |= {j.child for j in m.joints.values() if j.parent in reached}
    coupled = {*m.couplings, *(s for c in m.couplings.values() for s in c.sources)}
    ends = [
        j.child
        for j in m.joints.values()
        if j.type.type_name in {"revolute", "prismatic", "fixed", "spherical"}
        and not j.limits
        and j.name not in coupled
    ]
    children = [j.child for j in m.joints.values()]
    return (
        reached == set(m.bodies)
        and all(ends.count(b) >= children.count(b) - 1 for b in set(children))
        and ends.count(m.ground.name) == children.count(m.ground.name)
        and all(c.kind == "position" for c in m.constraints.values())
        and not any(b.particle for b in m.bodies.values())
        and all(j.type.type_name in kinds and not j.type.options for j in m.joints.values())
        and all(len(c.sources) == 1 for c in m.couplings.values())
    )


def fits_sdf(m: Mechanism) -> bool:
    """Whether a model of the library has joints that SDF has, and loops that zero closes."""
    kinds = {"revolute", "prismatic", "helical", "universal", "fixed", "spherical", "planar"}
    if m.constraints or any(b.particle for b in m.bodies.values()):
        return False
    if any(j.type.type_name not in kinds or "angles" in j.type.options for j in m.joints.values()):
        return False
    system = m.build()
    loops = m.joints.values() if system.structure.closures else ()
    X = {b: system.fk(system.neutral, b) for b in m.bodies}
    ends = [
        (
            X[j.parent] @ j.X_PF.evaluate_pose(m.parameters),
            X[j.child] @ j.X_CM.evaluate_pose(m.parameters),
        )
        for j in loops
    ]
    return all(np.abs(F - M).max() < 1e-9 for F, M in ends)


FITS: dict[str, Callable[[Mechanism], bool]] = {
    "urdf": fits_urdf,
    "toml": lambda m: True,
    "sdf": fits_sdf,
}
"""What a format can say, of the models of the library, written out beside the writers."""


MODELS = [
    (name, model, FITS[name](system.mechanism))
    for name in WRITTEN
    for model, system in shipped().items()
    if (name, model) != ("sdf", "joint_free")  # is written without its joint: see test_sdf_writer
]


@pytest.mark.parametrize(
    ("name", "model"), [(name, model) for name, model, fits in MODELS if not fits]
)
def test_other_models_of_the_library_are_refused_by_name(name: str, model: str, tmp_path: Path):
    row = FORMATS[name]
    m = read_mechanism(model)
    path = tmp_path / f"m{row.endings[0]}"
    with pytest.raises(DescriptionError) as caught:
        m.save(path)
    assert not path.exists()
    assert {p.allowed for p in caught.value.problems} <= set(row.cannot.values())
    parts = (*m.bodies, *m.joints, *m.constraints, *m.couplings)
    assert all(any(repr(part) in p.subject for part in parts) for p in caught.value.problems)


@pytest.mark.parametrize(
    ("name", "model"), some([(name, model) for name, model, fits in MODELS if fits], 3)
)
def test_models_of_the_library_come_back(name: str, model: str, tmp_path: Path):
    row = FORMATS[name]
    m = read_mechanism(model)
    path = tmp_path / f"m{row.endings[0]}"
    m.save(path)
    again = kempe.load(path)
    if not row.loses:
        assert again.mechanism == m
    system = m.build()
    # the tree of a file may be another one: bodies of open loops are elsewhere then
    q = (
        system.assemble(start=system.random(0, 5)).q
        if system.structure.closures
        else system.random(0, 5)
    )
    by_name = np.array([again.q(system.q_dict(row)) for row in q])
    for frame in system.frame_names:
        np.testing.assert_allclose(
            again.fk(by_name, frame), system.fk(q, frame), rtol=0, atol=1e-12
        )


class Unknown(Revolute):
    type_name = "unknown"


def a_part(m: Mechanism) -> None:
    m.couple("p.x", {"j": 1.0})


def locked_follower(m: Mechanism) -> None:
    m.couple("k", {"j": 1.0})
    m.lock({"k": 0.1})


CASES: dict[tuple[str, str], tuple[Callable[[Mechanism], object], str]] = {
    ("urdf", "loops closed by other joints, or by ones with limits"): (
        lambda m: m.universal("f", "b", "a"),
        "joint 'f'",
    ),
    ("urdf", "bodies that no joint carries"): (lambda m: m.body("x"), "body 'x'"),
    ("urdf", "joints of other types"): (lambda m: m.universal("u", "a", m.body("x")), "joint 'u'"),
    ("urdf", "limits of joints with several coordinates"): (
        lambda m: m.planar("f", "a", m.body("x"), limits={"x": (0, 1)}),
        "joint 'f'",
    ),
    ("urdf", "locks of a part of a joint"): (lambda m: m.lock({"p.x": 0.1}), "joint 'p'"),
    ("urdf", "locks of coordinates that follow others"): (locked_follower, "coordinate 'k'"),
    ("urdf", "couplings with several sources"): (
        lambda m: m.couple("k", {"j": 1.0, "p.x": 1.0}),
        "coordinate 'k'",
    ),
    ("urdf", "couplings of a part of a joint"): (a_part, "coordinate 'p.x'"),
    ("urdf", "particles"): (lambda m: m.free("f", "a", m.particle("x")), "body 'x'"),
    ("urdf", "constraints that are not joints"): (
        lambda m: m.distance("rod", "a", "b", 1.0),
        "constraint 'rod'",
    ),
    ("urdf", "ellipsoids"): (
        lambda m: m.shape("a", "ellipsoid", radii=(1, 2, 3)),
        "body 'a'",
    ),
    ("urdf", "control characters in names"): (lambda m: setattr(m, "name", "\x01"), r"name '\x01'"),
    ("sdf", "loops that are open where all coordinates are zero"): (
        lambda m: m.revolute("l", "ground", "b", at=(1, 0, 0)),
        "joint 'k'",
    ),
    ("sdf", "bodies that no joint carries"): (lambda m: m.body("x"), "mechanism"),
    ("sdf", "joints of other types"): (
        lambda m: m.cylindrical("u", "a", m.body("x")),
        "joint 'u'",
    ),
    ("sdf", "limits of joints with several coordinates"): (
        lambda m: m.planar("f", "a", m.body("x"), limits={"x": (0, 1)}),
        "joint 'f'",
    ),
    ("sdf", "locks of a part of a joint"): (lambda m: m.lock({"p.x": 0.1}), "joint 'p'"),
    ("sdf", "locks of coordinates that follow others"): (locked_follower, "coordinate 'k'"),
    ("sdf", "couplings with several sources"): (
        lambda m: m.couple("k", {"j": 1.0, "p.x": 1.0}),
        "coordinate 'k'",
    ),
    ("sdf", "couplings of a part of a joint"): (a_part, "coordinate 'p.x'"),
    ("sdf", "particles"): (lambda m: m.prismatic("f", "a", m.particle("x")), "body 'x'"),
    ("sdf", "constraints that are not joints"): (
        lambda m: m.distance("rod", "a", "b", 1.0),
        "constraint 'rod'",
    ),
    ("sdf", "names of its own, and equal ones"): (lambda m: m.frame("j", "a"), "frame 'j'"),
    ("sdf", "parts of a nested model that are tied to parts outside"): (
        lambda m: m.frame("arm::tip", "a"),
        "frame 'arm::tip'",
    ),
    ("sdf", "control characters in names"): (lambda m: setattr(m, "name", "\x01"), r"name '\x01'"),
    ("toml", "joints of types that are not in the table of joints"): (
        lambda m: m.joint("own", Unknown(), "a", m.body("x")),
        "joint 'own'",
    ),
    ("toml", "Python functions that are no expression"): (
        lambda m: m.equation("law", lambda x: float(x["j"]), of=("j",)),
        "constraint 'law'",
    ),
    ("toml", "expressions that are too long"): (
        lambda m: m.equation(
            "law", lambda x: sum(np.sin(x["j"] + i / 7) for i in range(2000)), of=("j",)
        ),
        "constraint 'law'",
    ),
}
"""For each thing that a format cannot say: what to add to a mechanism, and the subject of the
refusal."""


def test_each_thing_that_cannot_be_said_has_a_case():
    assert set(CASES) == {(name, what) for name, row in FORMATS.items() for what in row.cannot}


@pytest.mark.parametrize(("name", "what"), CASES, ids=lambda x: x.replace(" ", "_"))
def test_what_cannot_be_said_is_refused(name: str, what: str, tmp_path: Path):
    m = hinge()
    row = FORMATS[name]
    m.revolute("k", "a", m.body("b"))
    m.planar("p", "b", m.body("c"))
    path = tmp_path / f"m{row.endings[0]}"
    m.save(path)
    add, subject = CASES[name, what]
    add(m)
    with pytest.raises(DescriptionError) as caught:
        m.save(tmp_path / f"other{row.endings[0]}")
    (problem,) = caught.value.problems
    assert problem.subject == subject and problem.allowed == row.cannot[what]
    assert not (tmp_path / f"other{row.endings[0]}").exists()


@pytest.mark.parametrize("option", OPTIONS)
@pytest.mark.parametrize("name", WRITTEN)
def test_options_are_taken_or_refused(name: str, option: str):
    row = FORMATS[name]
    assert row.write is not None
    text = row.write(hinge())
    if option in row.options:
        assert read_mechanism(text, **{option: OPTIONS[option]}).joints
    else:
        words = f"the option {option!r} is for {join_titles(list_readable_formats(option))}, and this is {row.title}"
        with pytest.raises(InputError, match=words):
            read_mechanism(text, **{option: OPTIONS[option]})


@pytest.mark.parametrize("name", FORMATS)
def test_endings_tell_the_format(name: str, tmp_path: Path):
    row = FORMATS[name]
    for ending in row.endings:
        path = tmp_path / f"m{ending.upper()}"
        if row.write is None:
            with pytest.raises(InputError, match="it must be .urdf, .toml, .sdf or .world$"):
                hinge().save(path)
            path.write_text(READ_ONLY[name])
        else:
            hinge().save(path)
        if name == "mjcf":
            pytest.importorskip("mujoco")
        assert "j" in read_mechanism(path).joints


def test_a_format_that_is_only_known_by_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    row = Format("LATER", (".later",), recognises=lambda start: start.startswith("later"))
    monkeypatch.setitem(FORMATS, "later", row)
    path = tmp_path / "m.later"
    path.write_text("no text of any format")
    words = f"LATER files are not read; Kempe reads {join_titles(list_readable_formats(), 'and')}"
    for source in (path, "later\n", b"later\n"):
        with pytest.raises(UnsupportedError, match=re.escape(words)):
            read_mechanism(source)
    with pytest.raises(InputError, match="format is 'later'; it must be 'urdf', 'toml', "):
        read_mechanism(path, format="later")


@pytest.mark.parametrize(
    ("text", "ending", "title"),
    [
        ("<robot/>", ".xml", "URDF"),
        ("<robot/>", ".sdf", "SDF"),
        ("<!-- <sdf> --><robot/>", "", "URDF"),
        ("<sdf/>", ".urdf", "URDF"),
        ("<sdf/>", ".toml", "TOML"),
        ("<?xml?><!DOCTYPE sdf><sdf/>", "", "SDF"),
        ("<!--> --><!-- <robot> -->\n<mujoco/>", ".xml", "MJCF"),
        ("<mjcf/>", "", "MJCF"),
        ("format = 1", "", "TOML"),
        ("# a comment\nformat = 1", "", "TOML"),
        ("format = 1", ".sdf", "SDF"),
        ("<a", "", "URDF"),
        ("<!-- <sdf>", "", "URDF"),
        ("words", ".urdf", "URDF"),
        ("<x/>", ".toml", "TOML"),
        ("words", "", "TOML"),
    ],
)
def test_contents_and_endings_together(
    text: str, ending: str, title: str, tmp_path: Path, monkeypatch
):
    """Contents tell a format that is not read, and one where the ending tells none that is."""
    for name, row in FORMATS.items():

        def said(text, source, _title=row.title, **options):
            raise UnsupportedError(_title)

        changed = Format(
            row.title,
            row.endings,
            row.read and said,
            elements=row.elements,
            recognises=row.recognises,
            options=row.options,
        )
        monkeypatch.setitem(FORMATS, name, changed)
        if row is DEFAULT:
            monkeypatch.setattr("kempe.description.read.DEFAULT", changed)
    (tmp_path / f"m{ending}").write_text(text)
    with pytest.raises(UnsupportedError) as caught:
        read_mechanism(tmp_path / f"m{ending}")
    assert (
        str(caught.value).removeprefix(f"{tmp_path / f'm{ending}'}: ").partition(" files")[0]
        == title
    )


# ---- a row of one's own


DH = [
    {"a": 0.5, "alpha": 0.3, "d": 0.1, "theta": 0.2},
    {"a": 0.4, "type": "prismatic"},
    {"alpha": -1.0, "d": 0.2},
]


def test_a_format_of_ones_own_is_loaded_saved_and_converted(own: Format, tmp_path: Path):
    arm = from_dh(DH)
    path = arm.save(tmp_path / "arm.csv")
    assert path.read_text().startswith("type,a,alpha,d,theta\nrevolute,0.5,0.3,0.1,0.2\n")
    q = np.array([0.3, -0.2, 0.5])
    text = path.read_text()
    (tmp_path / "arm.txt").write_text(text)
    for source in (path, text, text.encode(), tmp_path / "arm.txt"):
        np.testing.assert_allclose(
            kempe.load(source).fk(q, "tool"), arm.build().fk(q, "tool"), rtol=0, atol=1e-14
        )
    assert read_mechanism(path, format="rows") == read_mechanism(text)
    assert check_description(path) == ((), ())
    for ending in (".csv", ".toml", ".urdf"):
        out = tmp_path / f"converted{ending}"
        result = Result("convert", str(path), str(out))
        assert result.code == 0 and f"written to {out}" in result.out
        again = kempe.load(out)
        np.testing.assert_allclose(
            again.fk(q, "tool"), arm.build().fk(q, "tool"), rtol=0, atol=1e-12
        )
    back = Result("convert", str(tmp_path / "converted.toml"), str(tmp_path / "back.csv"))
    assert back.code == 0 and "revolute,0.5,0.3,0.1,0.2\n" in (tmp_path / "back.csv").read_text()


def test_a_format_of_ones_own_is_in_the_messages(own: Format, tmp_path: Path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    from_dh(DH).save("arm.csv")
    said: list[tuple[Callable[[], object], str]] = [
        (lambda: read_mechanism("amr.csv"), "there is no such file; did you mean 'arm.csv'?"),
        (lambda: read_mechanism("."), "this is a folder; give one of its files: arm.csv"),
        (lambda: read_mechanism("arm.csv", format="cvs"), "or 'rows'"),
        (
            lambda: read_mechanism("arm.csv", base="free"),
            "the option 'base' is for URDF or SDF, and this is rows of a DH table",
        ),
        (
            lambda: read_mechanism(""),
            f"it must hold a description ({join_titles(list_readable_formats())})",
        ),
        (lambda: hinge().save("m.odt"), "it must be .urdf, .toml, .sdf, .world or .csv"),
        (
            lambda: read_mechanism("four_bar").save("m.csv"),
            "it leaves the chain; each body of a chain carries one joint at most",
        ),
        (lambda: read_mechanism("ball").save("m.csv"), "a row turns about z or slides along it"),
    ]
    for call, words in said:
        with pytest.raises(KempeError) as caught:
            call()
        assert words in str(caught.value)
    refused = Result("convert", "four_bar", "m.csv")
    assert refused.code == 2 and "it leaves the chain" in refused.err and not Path("m.csv").exists()
