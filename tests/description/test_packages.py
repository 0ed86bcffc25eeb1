"""Files that a robot's file names: found in its package, in folders that are named, in ROS's."""

from __future__ import annotations

from pathlib import Path

import pytest

from kempe.description.packages import Folders, list_folders_around
from kempe.errors import InputError

NAMED = "<package><!-- <name>other</name> --><name> {} </name></package>"


@pytest.fixture(autouse=True)
def without_ros(monkeypatch):
    for name in ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH", "ROS_ROOT"):
        monkeypatch.delenv(name, raising=False)


def made(folder: Path, *names: str) -> Path:
    """An empty file for each name; packages say the name that stands after "package.xml ="."""
    for name in names:
        path, _, package = name.partition("=")
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_text(NAMED.format(package) if package else "")
    return folder.resolve()


def found(path: str, *roots: Path | str) -> Path:
    return Folders(roots).find_file(path)


def test_meshes_inside_the_roots(tmp_path):
    a = made(tmp_path, "pkg/meshes/a.stl") / "pkg/meshes/a.stl"
    assert found("package://pkg/meshes/a.stl", tmp_path) == a
    assert found("package:///pkg/meshes/a.stl", tmp_path) == a
    assert found("package://pkg/meshes/a.stl", "/nowhere", tmp_path / "pkg") == a
    assert found("meshes/./a.stl", str(tmp_path / "pkg")) == a
    assert found("../meshes/a.stl", tmp_path / "pkg/meshes", tmp_path / "pkg") == a
    assert found("..\\pkg\\meshes\\a.stl", tmp_path / "pkg") == a


def test_links_are_followed_inside_the_roots_only(tmp_path):
    b = made(tmp_path, "b.stl", "in/pkg/c.stl") / "b.stl"
    pkg = tmp_path / "in" / "pkg"
    (pkg / "link.stl").symlink_to(b)
    (pkg / "up").symlink_to(tmp_path)
    assert found("in/pkg/link.stl", tmp_path) == b
    for path in ("link.stl", "up/b.stl", "../../b.stl", "package://pkg/link.stl"):
        with pytest.raises(InputError, match="leads out of the folders of the robot, to .*b.stl"):
            found(path, pkg)


@pytest.mark.parametrize(
    ("path", "words"),
    [
        ("../../b.stl", "leads out of the folders"),
        ("package://pkg/../../b.stl", "leads out of the folders"),
        ("a\\..\\..\\..\\b.stl", "leads out of the folders"),
        ("/etc/passwd", "absolute"),
        ("package:////etc/passwd", "absolute"),
        ("package:///etc/passwd", "no package 'etc'"),
        ("~/x", "absolute"),
        ("C:\\x", "absolute"),
        ("\\\\server\\x", "absolute"),
        ("file:///etc/passwd", "file:// is not followed"),
        ("http://a/b.stl", "http:// is not followed"),
        ("", "names no file"),
        ("package://", "names no file"),
        ("a\0b", "names no file"),
        ("pkg", "no such file"),
        ("package://pkg", "no such file"),
        ("missing.stl", "no such file; looked in"),
    ],
)
def test_paths_that_are_refused(path: str, words: str, tmp_path):
    made(tmp_path, "b.stl", "in/pkg/a/c.stl")
    with pytest.raises(InputError, match=words):
        found(path, tmp_path / "in" / "pkg")


def test_without_roots():
    with pytest.raises(InputError, match="declare some by package_dirs"):
        found("a.stl")


def test_packages_above_the_file(tmp_path):
    made(tmp_path, "ws/arm/urdf/x.urdf", "ws/arm/meshes/a.stl", "ws/hand/meshes/b.stl", "c.stl")
    urdf = tmp_path / "ws/arm/urdf"
    assert list_folders_around(urdf) == [urdf, urdf.parent]
    assert found("package://arm/meshes/a.stl", urdf).name == "a.stl"
    assert found("../meshes/a.stl", urdf).name == "a.stl"
    with pytest.raises(InputError, match="leads out"):
        found("../../hand/meshes/b.stl", urdf)
    made(tmp_path, "ws/arm/package.xml=left_arm", "ws/hand/package.xml=left_hand")
    assert list_folders_around(urdf) == [urdf, tmp_path / "ws/arm", tmp_path / "ws"]
    for path in (
        "package://arm/meshes/a.stl",
        "package://left_arm/meshes/a.stl",
        "package://left_hand/meshes/b.stl",
        "../../hand/meshes/b.stl",
        "package://ws/arm/meshes/a.stl",
    ):
        assert found(path, urdf).is_file()
    with pytest.raises(InputError, match="leads out"):
        found("../../../c.stl", urdf)


def test_a_home_folder_is_no_package(tmp_path, monkeypatch):
    home = made(tmp_path, "home/u/package.xml=u", "home/u/d/x.urdf") / "home/u"
    monkeypatch.setenv("HOME", str(home))
    assert list_folders_around(home) == []
    assert list_folders_around(home / "d") == [home / "d"]
    assert "u" not in Folders([home / "d"]).packages


def test_a_package_that_names_itself_comes_first(tmp_path):
    made(tmp_path, "a/legs/x", "a/b/renamed/package.xml=legs", "a/hidden/.git/package.xml=legs")
    made(tmp_path, "a/b/renamed/inner/package.xml=inner", "a/b/nameless/package.xml")
    packages = Folders([tmp_path / "a"]).packages
    assert packages["legs"] == tmp_path / "a/b/renamed"
    assert packages["nameless"] == tmp_path / "a/b/nameless"
    assert "inner" not in packages


def test_packages_of_ros(tmp_path, monkeypatch):
    made(tmp_path, "one/arm/package.xml=arm", "one/arm/a.stl", "two/share/hand/package.xml=hand")
    made(tmp_path, "two/share/hand/b.stl", "two/c.stl", "file/x.urdf", "one/d.stl")
    monkeypatch.setenv("ROS_PACKAGE_PATH", f"{tmp_path / 'one'}:/nowhere")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "two"))
    file = tmp_path / "file"
    assert found("package://arm/a.stl", file).name == "a.stl"
    assert found("package://hand/b.stl", file).name == "b.stl"
    with pytest.raises(InputError, match="no package 'two'"):
        found("package://two/c.stl", file / "urdf")
