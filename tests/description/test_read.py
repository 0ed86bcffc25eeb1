"""Finding out what a source is; files that are not there."""

from __future__ import annotations

import bz2
import gzip
import io
import lzma
import os
import tarfile
import zipfile
from pathlib import Path

import numpy as np
import pytest
from bad_file_cases import SHOULDER, TOML_CASES, URDF_CASES, WRIST, joint, robot
from robots import urdf_files

from kempe import library
from kempe.description.formats import OTHER_KINDS, find_other_kind
from kempe.description.read import check_description, read_mechanism
from kempe.description.toml_writer import write_toml
from kempe.errors import DescriptionError, InputError
from kempe.library import list_models as library_models

URDF = robot(SHOULDER, WRIST)
TOML = write_toml(read_mechanism(URDF))


@pytest.mark.parametrize("text", [URDF, TOML], ids=["urdf", "toml"])
@pytest.mark.parametrize("suffix", [".right", ".txt", ""])
def test_text_bytes_and_files(text: str, suffix: str, tmp_path: Path):
    expected = read_mechanism(URDF)
    right = ".urdf" if text == URDF else ".toml"
    path = tmp_path / f"model{suffix.replace('.right', right)}"
    path.write_text(text, encoding="utf-16" if text == URDF else "utf-8")
    for source in (text, text.encode(), "\n" + text if text == TOML else text, path, str(path)):
        assert read_mechanism(source) == expected
    assert read_mechanism(path, format=right[1:]) == expected
    assert read_mechanism(path, package_dirs=["/meshes"]).roots == (str(tmp_path), "/meshes")
    assert read_mechanism(text).roots == ()


def test_options_of_urdf_reach_the_reader():
    assert read_mechanism(URDF, base="free").ground.name == "world"
    with pytest.raises(
        InputError,
        match="the option 'base' is for URDF or SDF, and this is TOML; save it as URDF first",
    ):
        read_mechanism(TOML, base="free")
    with pytest.raises(InputError, match="format is 'usd'; it must be 'urdf', 'toml'"):
        read_mechanism(URDF, format="usd")
    with pytest.raises(InputError, match="it must be a path, text or bytes"):
        read_mechanism(5)  # type: ignore[arg-type]


def test_models_of_the_library():
    for name in library_models():
        assert read_mechanism(name).build().nq >= 0
    if library_models():
        name = library_models()[0]
        with pytest.raises(DescriptionError, match=f"did you mean .*{name!r}"):
            read_mechanism(name + "x")


def test_a_file_goes_before_a_model_of_the_library(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("kempe.description.read.library_models", lambda: ("arm",))
    Path("arm").write_text(URDF)
    assert read_mechanism("arm").name == "r"


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("model.udrf", "there is no such file; did you mean 'model.urdf'"),
        ("MODEL", "there is no such file; did you mean 'model.urdf'"),
        ("zzzzzz.urdf", "there is no such file; there are: model.urdf, other.toml"),
        ("zzzzzz.xml", "there is no such file; there are: model.urdf, other.toml"),
        ("nowhere/model.urdf", "there is no folder 'nowhere' either"),
        ("empty/x.urdf", "there are no robot files in that folder"),
        (".", "this is a folder; give one of its files: model.urdf, other.toml"),
        ("empty", "this is a folder; give the path of a file"),
        ("a\0b.urdf", "holds a zero byte, which no name of a file has"),
        ("n" * 5000, "cannot be read: File name too long"),
        (
            "model.urdf.xacro",
            "this is a xacro file, a program that writes URDF; load it with xacro=True",
        ),
    ],
)
def test_files_that_are_not_there(source: str, words: str, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("model.urdf").write_text(URDF)
    Path("other.toml").write_text(TOML)
    Path("empty").mkdir()
    if source.endswith(".xacro"):
        Path(source).write_text(URDF)
    with pytest.raises((DescriptionError, InputError), match=words):
        read_mechanism(source)


@pytest.mark.skipif(
    os.name != "posix" or os.geteuid() == 0, reason="needs a user whom files can be closed to"
)
def test_files_without_permission(tmp_path):
    path = tmp_path / "m.urdf"
    path.write_text(URDF)
    path.chmod(0)
    with pytest.raises(DescriptionError, match="cannot be read: Permission denied"):
        read_mechanism(path)


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="needs /dev/zero")
def test_endless_files():
    with pytest.raises(DescriptionError, match="this is a device"):
        read_mechanism("/dev/zero")


def test_check_collects_what_reading_and_building_find(tmp_path):
    good = check_description(robot(joint("j", ""), WRIST))
    assert good.problems == () and len(good.notes) == 1
    bad = check_description(URDF.replace('"arm"/>', '"amr"/>', 1))
    assert [p.where.line for p in bad.problems if p.where] == [5, 6] and bad.notes == ()
    (problem,) = check_description("format = 1\n[[body]]\nname = 'lost'\n").problems
    assert problem.where is not None and problem.where.line == 2
    (problem,) = check_description(tmp_path / "nothing.urdf").problems
    assert "no such file" in problem.message
    (problem,) = check_description(URDF, root="x").problems
    assert "no link 'x'" in problem.message


# ---- files of another kind


def packed(open_archive) -> bytes:
    """An archive that holds a robot description."""
    out = io.BytesIO()
    open_archive(out)
    return out.getvalue()


def tarred(out: io.BytesIO) -> None:
    with tarfile.open(fileobj=out, mode="w") as archive:
        entry = tarfile.TarInfo("robot.urdf")
        entry.size = len(URDF)
        archive.addfile(entry, io.BytesIO(URDF.encode()))


def zipped(out: io.BytesIO) -> None:
    with zipfile.ZipFile(out, "w") as archive:
        archive.writestr("robot.urdf", URDF)


def saved(out: io.BytesIO) -> None:
    np.save(out, np.zeros((2, 3)))


def scene(name: str) -> bytes:
    """A triangle as trimesh writes it."""
    trimesh = pytest.importorskip("trimesh")
    mesh = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    made = mesh.export(file_type=name)
    return made.encode() if isinstance(made, str) else made


PNG = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR"
OTHERS = [
    (
        "Git LFS",
        "git lfs pull",
        b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12345\n",
    ),
    ("symbolic link", "the file that it names", b"../urdf/robot.urdf"),
    ("web page", "Raw", b"<!DOCTYPE html><html><head><title>404</title></head></html>"),
    ("web page", "Raw", b"\n<!-- saved from -->\n<HTML lang='en'>\n<body></body></HTML>"),
    ("web page", "Raw", b"<!doctype HTML>\n<title>robot.urdf</title><p>text"),
    (
        "web page",
        "Raw",
        b'<?xml version="1.0"?><!DOCTYPE html PUBLIC "-//W3C//DTD XHTML 1.0//EN" "x">\n<html/>',
    ),
    ("web server", "address", b"404: Not Found"),
    ("web server", "address", b'<?xml version="1.0"?>\n<Error><Code>AccessDenied</Code></Error>'),
    ("gzip", "unpack", gzip.compress(URDF.encode())),
    ("gzip", "unpack", gzip.compress(TOML.encode())),
    ("bzip2", "unpack", bz2.compress(URDF.encode())),
    ("xz", "unpack", lzma.compress(URDF.encode())),
    ("Zstandard", "unpack", b"\x28\xb5\x2f\xfd\x04\x00\x19\x00"),
    ("ZIP", "unpack", packed(zipped)),
    ("7z", "unpack", b"7z\xbc\xaf\x27\x1c\0\x04"),
    ("RAR", "unpack", b"Rar!\x1a\x07\x01\0"),
    ("tar archive", "unpack", packed(tarred)),
    ("USD", "URDF", b'#usda 1.0\ndef Xform "a" {}\n'),
    ("USD", "URDF", b"PXR-USDC\0\x08"),
    ("VRML", "URDF", b"#VRML V2.0 utf8\nTransform {}\n"),
    ("VRML", "URDF", b"#VRML_SIM R2022b utf8\nWorldInfo {\n}\n"),
    ("COLLADA", "joints", b'<?xml version="1.0"?><COLLADA version="1.4.1"></COLLADA>'),
    ("STL", "joints", b"solid part of a robot\n facet normal 0 0 1\n  outer loop\n"),
    ("OBJ", "joints", b"# a mesh\nmtllib a.mtl\no box\nv 0.0 -1e-3 2\nv 1 0 0\n"),
    ("PLY", "joints", b"ply\nformat ascii 1.0\n"),
    ("glTF", "joints", b"glTF\x02\0\0\0"),
    ("STEP", "CAD", b"ISO-10303-21;\nHEADER;\n"),
    ("PDF", "robot description", b"%PDF-1.7\n"),
    ("PNG", "picture", PNG),
    ("JPEG", "picture", b"\xff\xd8\xff\xe0\0\x10JFIF"),
    ("GIF", "picture", b"GIF89a\x01\0"),
    ("SVG", "picture", b'<?xml version="1.0"?>\n<svg xmlns="http://www.w3.org/2000/svg"/>'),
    ("numpy", "map_file", packed(saved)),
    ("Parquet", "map_file", b"PAR1\x15\x04\x15"),
    ("HDF5", "robot description", b"\x89HDF\r\n\x1a\n\0"),
    ("JSON", "no JSON", b'{\n  "message": "Not Found"\n}\n'),
    ("JSON", "no JSON", b"{}\n"),
    ("launch file", "URDF", b"<launch><param name='robot_description'/></launch>"),
    (
        "package manifest",
        "package",
        b"<?xml version='1.0'?><package format='3'><name>r</name></package>",
    ),
    (
        "SRDF",
        "load the URDF",
        b'<robot name="r">\n<group name="arm"><chain base_link="a" tip_link="b"/></group></robot>',
    ),
    (
        "SRDF",
        "<virtual_joint>",
        b'<robot name="r"><virtual_joint name="v" type="fixed" child_link="b"/></robot>',
    ),
    (
        "SRDF",
        "<group_state>",
        b'<robot name="r"><group name="g"><link name="a"/></group><group_state name="h"/></robot>',
    ),
]
"""What the message names, what it advises, and the file."""


@pytest.mark.parametrize(("what", "advice", "data"), OTHERS)
def test_a_file_of_another_kind_is_named(what: str, advice: str, data: bytes, tmp_path: Path):
    sources: list[tuple[str, object, str | None]] = [
        ("<text>", data, None),
        ("<text>", data, "urdf"),
    ]
    for name in ("a.urdf", "a.toml", "a.xml", "a"):
        (tmp_path / name).write_bytes(data)
        sources.append((str(tmp_path / name), tmp_path / name, None))
    text = data.decode(errors="replace")
    if text.encode() == data:
        sources += [("<text>", f"\n{text}", "urdf"), ("<text>", f" {text}\n ", "toml")]
        if b"\0" not in data:
            sources += [
                ("<text>", text.encode(encoding), None) for encoding in ("utf-8-sig", "utf-16")
            ]
    if what == "SRDF":
        sources = [s for s in sources if not str(s[0]).endswith(".toml") and s[2] != "toml"]
    for place, source, format in sources:
        with pytest.raises(DescriptionError) as caught:
            read_mechanism(source, format=format)  # type: ignore[arg-type]
        (problem,) = caught.value.problems
        assert problem.message.startswith("this is a") and what in problem.message, (
            source,
            str(problem),
        )
        assert advice in problem.message + problem.allowed and problem.where is not None
        assert (problem.where.file, problem.where.line) == (place, 1) or what == "SRDF"
        assert str(caught.value).count(place) == 1 and "\0" not in str(caught.value)


def test_each_other_kind_has_an_example():
    kinds = {kind.what for _, _, data in OTHERS if (kind := find_other_kind(data))}
    assert kinds == {kind.what for kind in OTHER_KINDS}


@pytest.mark.parametrize(
    ("name", "what"),
    [
        ("dae", "COLLADA"),
        ("stl_ascii", "STL"),
        ("obj", "OBJ"),
        ("ply", "PLY"),
        ("glb", "glTF"),
        ("gltf", "JSON"),
    ],
)
def test_meshes_that_trimesh_writes_are_named(name: str, what: str):
    if name == "dae":
        pytest.importorskip("collada")
    made = scene(name) if name != "gltf" else scene("glb")[20:].lstrip()
    kind = find_other_kind(made)
    assert kind is not None and what in kind.what


def test_no_valid_file_is_taken_for_another_kind(hunt):
    """Shipped models, robots of example-robot-data, and what is written of them, behind blanks,
    comments and marks.
    """
    rng = hunt.rng()
    texts = [library.find_model_file(name).read_text(encoding="utf-8") for name in library_models()]
    texts += [path.read_text(encoding="utf-8", errors="replace") for path in urdf_files().values()]
    texts += [case.text for case in (*URDF_CASES, *TOML_CASES) if case.says is None]
    for text in texts:
        assert find_other_kind(text) is None and find_other_kind(text.encode()) is None
    words = [
        data.decode("latin-1").replace("\0", "").replace("--", "").strip() for _, _, data in OTHERS
    ]
    for _ in range(hunt.cases(1000)):
        text = texts[rng.integers(len(texts))]
        word = words[rng.integers(len(words))].splitlines()[0]
        if text.lstrip("\ufeff \r\n").startswith("<"):
            comment = "" if text.lstrip("\ufeff \r\n").startswith("<?") else f"<!-- {word} -->"
        else:
            comment = f"# {word}\n"
        changed = rng.choice(["", "\n", " \r\n\t"]) + comment + text
        encoding = str(rng.choice(["utf-8", "utf-8-sig", "utf-16"]))
        assert find_other_kind(changed) is None, changed[:200]
        assert find_other_kind(changed.encode(encoding, "replace")) is None, (
            encoding,
            changed[:200],
        )


@pytest.mark.parametrize("text", ["<sdf version='1.9'/>", "<mjcf/>"])
def test_a_message_names_the_path_once(text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "m.xml").write_text(text)
    (tmp_path / "folder").mkdir()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))
    for source in (
        "m.xml",
        "./m.xml",
        "~/m.xml",
        "../" + tmp_path.name + "/m.xml",
        tmp_path / "m.xml",
        "folder",
    ):
        for given in ({}, {"xacro": False}):
            (problem,) = check_description(source, **given).problems
            assert (
                str(problem).count("m.xml") == (source != "folder")
                and str(problem).count("folder") < 3
            ), str(problem)
    (problem,) = check_description(text).problems
    assert str(problem).count("<text>") == 1


def test_files_of_the_home_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / "m.urdf").write_text(URDF)
    (tmp_path / "models").mkdir()
    for source in ("~/m.urdf", Path("~/m.urdf")):
        m = read_mechanism(source, package_dirs=["~/models"])
        assert m == read_mechanism(tmp_path / "m.urdf") and m.roots == (
            str(tmp_path),
            str(tmp_path / "models"),
        )
    assert check_description("~/m.urdf").problems == ()
    with pytest.raises(DescriptionError, match=f"{tmp_path}/no.urdf: there is no such file"):
        read_mechanism("~/no.urdf")
    with pytest.raises(DescriptionError, match="there is no"):
        read_mechanism("~nobody-of-this-name/m.urdf")


@pytest.mark.parametrize(
    ("source", "words"),
    [
        (
            "https://example.org/a/ur5.urdf",
            "'https://example.org/a/ur5.urdf' is a URL; .* download it first",
        ),
        (
            Path("https://example.org/a.urdf"),
            "'https://example.org/a.urdf' is a URL; .* download it first",
        ),
        ("git+ssh://x/y.urdf", "'git.ssh://x/y.urdf' is a URL"),
        ("file:///tmp/a.urdf", "is a URL; give the path alone, without file://"),
        ("package://ur/ur5.urdf", "is a URL; give the path of the file"),
    ],
)
def test_a_url_is_called_one(source, words: str):
    with pytest.raises(InputError, match=words):
        read_mechanism(source)
    assert "is a URL" in str(check_description(source).problems[0])
    with pytest.raises(InputError, match="is a URL"):
        read_mechanism("m.urdf", package_dirs=[source])


def test_lenient_limits_are_for_urdf():
    with pytest.raises(InputError, match="the option 'lenient_limits' is for URDF"):
        read_mechanism(TOML, lenient_limits=True)
