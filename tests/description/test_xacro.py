"""Expansion of xacro files: arguments, packages, and what goes wrong."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from bad_file_cases import LIMIT, joint

import kempe
from kempe.description import xacro as xacro_module
from kempe.description.read import check_description, read_mechanism
from kempe.description.xacro import expand_xacro
from kempe.errors import DescriptionError, InputError, MissingExtraError, UnknownNameError

XACRO = '<robot name="x" xmlns:xacro="http://www.ros.org/wiki/xacro">\n{}\n</robot>\n'


def expanded(tmp_path: Path, inside: str, seconds: float = 600, **options) -> str:
    path = tmp_path / "m.urdf.xacro"
    path.write_text(XACRO.format(inside))
    pytest.importorskip("xacrodoc")
    return expand_xacro(path, seconds=seconds, **options)


def test_xacro_is_expanded_on_request(tmp_path):
    pytest.importorskip("xacrodoc")
    (tmp_path / "part.xacro").write_text(
        XACRO.format('<xacro:macro name="leg" params="n"><link name="leg${n}"/></xacro:macro>')
    )
    path = tmp_path / "m.urdf.xacro"
    path.write_text(
        XACRO.format(
            '<xacro:include filename="part.xacro"/><xacro:property name="l" value="0.25"/><link '
            'name="a"/>'
            + '<xacro:leg n="1"/>'
            + joint("j", '<origin xyz="${2*l} 0 0"/>' + LIMIT, parent="a", child="leg1")
        )
    )
    m = read_mechanism(path, xacro=True)
    assert m.joints["j"].X_PF.steps[0] == ("x", (0.5,)) and m.roots == (str(tmp_path),)
    assert m.joints["j"].where is not None and m.joints["j"].where.file.endswith(
        "m.urdf.xacro (expanded)"
    )
    with pytest.raises(InputError, match="from a file, not from text"):
        read_mechanism(path.read_text(), xacro=True)


LEG = '<xacro:macro name="leg" params="n"><link name="leg${n}"/></xacro:macro>'
USE = '<xacro:include filename="$(find my_legs)/urdf/part.xacro"/><xacro:leg n="1"/>'


@pytest.mark.parametrize("dirs", [["packages"], ["packages/my_legs"], ["other", "packages"]])
def test_a_folder_of_the_packages_name_is_taken_for_it(dirs, tmp_path):
    folder = tmp_path / "packages" / "my_legs" / "urdf"
    folder.mkdir(parents=True)
    (folder / "part.xacro").write_text(XACRO.format(LEG))
    assert '<link name="leg1"/>' in expanded(
        tmp_path, USE, package_dirs=[tmp_path / d for d in dirs]
    )


def test_a_folder_above_the_file_is_taken_for_its_package(tmp_path):
    folder = tmp_path / "my_legs" / "urdf"
    folder.mkdir(parents=True)
    (folder / "part.xacro").write_text(XACRO.format(LEG))
    assert '<link name="leg1"/>' in expanded(folder, USE)


def test_a_package_that_names_itself_comes_first(tmp_path):
    for name, leg in (("my_legs", "wrong"), ("renamed", "right")):
        folder = tmp_path / "packages" / name / "urdf"
        folder.mkdir(parents=True)
        (folder / "part.xacro").write_text(XACRO.format(LEG.replace("leg$", f"{leg}$")))
    (tmp_path / "packages" / "renamed" / "package.xml").write_text(
        '<package format="2"><name>my_legs</name><version>1.0.0</version><description>d</description>'
        '<maintainer email="a@b.c">m</maintainer><license>l</license></package>'
    )
    assert '<link name="right1"/>' in expanded(tmp_path, USE, package_dirs=[tmp_path / "packages"])


@pytest.mark.parametrize("dirs", [[], ["empty"]])
def test_a_package_that_is_not_found_is_named(dirs, tmp_path):
    (tmp_path / "empty").mkdir()
    where = f" in '{tmp_path}/empty'" if dirs else ""
    words = (
        f"m.urdf.xacro: xacro finds no package 'my_legs'{where}; name by package_dirs a folder "
        "that holds one"
    )
    with pytest.raises(DescriptionError, match=words):
        expanded(tmp_path, USE, package_dirs=[tmp_path / d for d in dirs])


def test_xacro_arguments(tmp_path):
    text = expanded(
        tmp_path, '<xacro:arg name="n" default="b"/><link name="$(arg n)"/>', arguments={"n": "c"}
    )
    assert '<link name="c"/>' in text


ARM = """<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name="$(arg name)">
<!-- <xacro:arg name="old" default="1"/> $(arg older) -->
<xacro:arg name="name" default="arm"/>
<xacro:include filename="arm.xacro"/>
<xacro:arg name="kind" default="none"/>
<xacro:arg name="sizes" default="$(arg kind).yaml"/>
<xacro:arg name="hand" default="false"/>
<xacro:arm sizes="$(arg sizes)" hand="$(arg hand)"/>
</robot>"""
ARM_MACRO = """<robot xmlns:xacro="http://www.ros.org/wiki/xacro">
<xacro:arg name="scale" default='1.0'/>
<xacro:macro name="arm" params="sizes hand">
<xacro:property name="given" value="${xacro.load_yaml(sizes)}"/>
<link name="base"/><link name="fore"/>
<joint name="j" type="continuous"><parent link="base"/><child link="fore"/>
<origin xyz="${given['length'] * $(arg scale)} 0 0"/></joint>
<xacro:if value="${hand}"><link name="hand"/><joint name="grip" type="fixed">
<parent link="fore"/><child link="hand"/></joint></xacro:if></xacro:macro></robot>"""
DECLARED = "name (default 'arm'), kind (default 'none'), sizes, hand (default 'false')"


@pytest.fixture
def arm(tmp_path):
    """A xacro file whose root uses an argument before it is declared, as Universal Robots' does."""
    pytest.importorskip("xacrodoc")
    (tmp_path / "arm.urdf.xacro").write_text(ARM)
    (tmp_path / "arm.xacro").write_text(ARM_MACRO)
    (tmp_path / "long.yaml").write_text("length: 0.5")
    return tmp_path / "arm.urdf.xacro"


@pytest.mark.slow
def test_arguments_given_to_load(arm):
    system = kempe.load(arm, xacro={"name": "left", "kind": "long"})
    assert system.name == "left" and system.body_names == ("base", "fore")
    assert np.allclose(system.fk(system.neutral, "fore")[:3, 3], [0.5, 0, 0], atol=1e-15)
    given = {"name": "left", "kind": "long", "hand": True, "scale": np.float64(0.5)}
    system = kempe.load(arm, xacro=given)
    assert system.body_names == ("base", "fore", "hand")
    assert np.allclose(system.fk(system.neutral, "hand")[:3, 3], [0.25, 0, 0], atol=1e-15)
    assert check_description(arm, xacro=given) == ((), ())
    assert kempe.load(arm, xacro={**given, "hand": np.False_}).body_names == ("base", "fore")


@pytest.mark.parametrize(
    ("given", "error", "words"),
    [
        (
            True,
            DescriptionError,
            "xacro needs the argument 'name', used before its <xacro:arg>; give it by "
            "xacro={name: value}; arguments of this file: " + DECLARED,
        ),
        (
            {"name": "a"},
            DescriptionError,
            "or name its folders by package_dirs, or give its arguments by xacro={name: value}: "
            + DECLARED
            + ", scale (default '1.0')",
        ),
        ({"nam": "a"}, DescriptionError, DECLARED + "; not 'nam'"),
        (
            {"name": "a", "kind": "long", "hnad": True},
            UnknownNameError,
            "arm.urdf.xacro has no xacro argument 'hnad'; did you mean 'hand'?",
        ),
        (
            {"name": "a", "kind": "long", "old": "1"},
            UnknownNameError,
            "no xacro argument 'old'; there are: 'name', 'kind', 'sizes', 'hand', 'scale'",
        ),
        (
            {"name": "a", "kind": "long", "older": "1"},
            UnknownNameError,
            "no xacro argument 'older'",
        ),
        (
            {"name": ["a"]},
            InputError,
            "xacro argument 'name' is ['a']; it must be a text, a number",
        ),
        ({"name": None}, InputError, "xacro argument 'name' is None; it must be"),
        ({1: "a"}, InputError, "xacro has the key 1; names of arguments are texts"),
        ("name=a", InputError, "xacro is 'name=a'; it must be True, or a dict"),
        (1, InputError, "xacro is 1; it must be True, or a dict"),
    ],
)
def test_arguments_that_xacro_cannot_use(given, error, words: str, arm):
    with pytest.raises(error, match=re.escape(words)):
        read_mechanism(arm, xacro=given)
    if error is DescriptionError:
        (problem,) = check_description(arm, xacro=given).problems
        assert problem.where and problem.where.file == str(arm)


def test_an_argument_that_is_only_used_can_be_given(tmp_path):
    pytest.importorskip("xacrodoc")
    inside = '<link name="$(arg n)"/><link name="${xacro.arg(\'m\')}"/>'
    with pytest.raises(DescriptionError, match="needs the argument 'n'; .* arguments .*: n, m$"):
        expanded(tmp_path, inside)
    assert '<link name="2.5"/>' in expanded(tmp_path, inside, arguments={"n": "a", "m": 2.5})


def test_xacro_in_a_home_folder_reads_the_files_beside_it_alone(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    for name in ("parts.xacro", "secret/parts.xacro"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(
            '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><link name="arm"/></robot>'
        )
    assert '<link name="arm"' in expanded(tmp_path, '<xacro:include filename="parts.xacro"/>')
    with pytest.raises(
        DescriptionError, match=r"secret/parts.xacro lies outside the folders of the robot"
    ):
        expanded(tmp_path, '<xacro:include filename="secret/parts.xacro"/>')
    assert '<link name="arm"' in expanded(
        tmp_path,
        '<xacro:include filename="secret/parts.xacro"/>',
        package_dirs=[tmp_path / "secret"],
    )


@pytest.mark.parametrize(
    ("inside", "words"),
    [
        ('<xacro:macro name="m"><xacro:m/></xacro:macro><xacro:m/>', "calls itself without end"),
        ('<link name="${nothing}"/>', "xacro failed: .*nothing"),
        ('<link name="${10**9*[0]}"/>', "more than 2 GiB of memory"),
        ('<link name="${9**9**9}"/>', "did not finish in 1 s"),
        ('<link name="$(env KEMPE_SECRET)"/>', "KEMPE_SECRET"),
        ('<xacro:include filename="missing.xacro"/>', "missing.xacro"),
        ("<link", "xacro failed"),
        (
            "<xacro:property name='x' value=\"${load_yaml('/etc/passwd')}\"/><link name='${x}'/>",
            "/etc/passwd lies outside",
        ),
        (
            '<xacro:include filename="/etc/hostname"/>',
            "/etc/hostname lies outside the folders of the robot",
        ),
        (
            '<xacro:include filename="../../../../../../../../etc/hostname"/>',
            "/etc/hostname lies outside",
        ),
    ],
)
def test_xacro_that_goes_wrong(inside: str, words: str, tmp_path, monkeypatch):
    monkeypatch.setenv("KEMPE_SECRET", "hunter2")
    with pytest.raises(DescriptionError, match=words) as caught:
        expanded(tmp_path, inside, seconds=1 if "1 s" in words else 600)
    assert "hunter2" not in str(caught.value)


def test_links_out_of_the_folders_of_a_robot_are_not_followed(tmp_path):
    (tmp_path / "away").mkdir()
    (tmp_path / "away" / "secret.yaml").write_text("word: hunter2")
    folder = tmp_path / "robots" / "arm" / "urdf"
    folder.mkdir(parents=True)
    (folder / "config.yaml").symlink_to(tmp_path / "away" / "secret.yaml")
    use = (
        "<xacro:property name='x' value=\"${load_yaml('config.yaml')}\"/><link "
        "name=\"${x['word']}\"/>"
    )
    with pytest.raises(DescriptionError, match="secret.yaml lies outside") as caught:
        expanded(folder, use)
    assert "hunter2" not in str(caught.value)
    assert "hunter2" in expanded(folder, use, package_dirs=[tmp_path / "away"])


def test_neighbours_of_a_package_are_read(tmp_path):
    folder = tmp_path / "robots" / "arm" / "urdf"
    folder.mkdir(parents=True)
    (tmp_path / "robots" / "arm" / "package.xml").write_text(
        '<package format="2"><name>arm</name><version>1.0.0</version><description>d</description>'
        '<maintainer email="a@b.c">m</maintainer><license>l</license></package>'
    )
    (tmp_path / "robots" / "tool.yaml").write_text("length: 0.2")
    text = expanded(
        folder,
        "<xacro:property name='x' value=\"${load_yaml('../../tool.yaml')}\"/><link "
        "name=\"${x['length']}\"/>",
    )
    assert '"0.2"' in text


def test_xacro_without_the_extra(tmp_path, monkeypatch):
    monkeypatch.setattr(xacro_module.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(MissingExtraError, match=r"kempe\[xacro\]"):
        expand_xacro(tmp_path / "m.xacro")
