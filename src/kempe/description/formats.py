"""Table of file formats: readers, writers, detection of a format, and unsupported features.

Reading, writing, messages, the command line and the page of formats follow from it. A format of
your own is a row: ``FORMATS["x"] = Format(...)``.
"""

from __future__ import annotations

import codecs
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from kempe.late import call_late_function

_ROOT = re.compile(
    r"(?>[^<]*(?:<!--.*?-->|<\?.*?\?>|<![^->][^>]*>))*+[^<]*<([A-Za-z_][\w.:-]*)", re.DOTALL
)


@dataclass(frozen=True)
class Format:
    """File format of robots and mechanisms, with its reader and its writer.

    A reader is called as ``read(text, source, **options)`` with text or bytes
    (`kempe.description.source.decode_text` gives text), the name of their source for messages, and those
    of `options` that were given. A writer takes the mechanism and gives text. Both raise
    `DescriptionError` with all that is wrong.
    """

    title: str
    """Its name in messages."""
    endings: tuple[str, ...]
    """Endings of file names, with their dots, in lower case."""
    read: Callable[..., Any] | None = None
    """Text -> mechanism; None where the format is only known by name."""
    write: Callable[[Any], str] | None = None
    """Mechanism -> text; None where it is not written."""
    elements: tuple[str, ...] = ()
    """Names that its outermost element may have, where it is XML."""
    recognises: Callable[[str], bool] = lambda start: False
    """Whether a text that begins so, blanks left out, is in this format whatever its file is
    called."""
    options: tuple[str, ...] = ()
    """Options of `kempe.load` that the reader takes; `beside` are the names of files in the same
    folder."""
    cannot: Mapping[str, str] = field(default_factory=dict[str, str])
    """What the format cannot say, and so the writer refuses, with what is allowed instead."""
    loses: tuple[str, ...] = ()
    """What the writer leaves out or replaces without refusing it; with nothing here a file gives an
    equal mechanism."""


def find_root_element(text: str) -> str:
    """Return the name of the outermost element of an XML text; '' for any other text."""
    found = _ROOT.match(text, 0, 65536) if text.startswith("<") else None
    return found[1] if found else ""


URDF = Format(
    "URDF",
    (".urdf",),
    partial(call_late_function, "read_urdf"),
    partial(call_late_function, "write_urdf"),
    elements=("robot",),
    recognises=lambda start: start.startswith("<"),
    options=("base", "root", "lenient_limits", "package_dirs", "srdf", "beside"),
    cannot={
        "loops closed by other joints, or by ones with limits": (
            "a <loop_joint> is revolute, prismatic, spherical or fixed, and has neither limits nor a "
            "mimic: mark another joint of the loop by cut=True, or save as .toml"
        ),
        "bodies that no joint carries": "join them to the ground, by joints from parent to child",
        "joints of other types": (
            "URDF has revolute, prismatic, fixed, planar, and free and spherical by quaternion"
        ),
        "limits of joints with several coordinates": "remove them",
        "locks of a part of a joint": "lock all of them, or none",
        "locks of coordinates that follow others": "lock what it follows",
        "couplings with several sources": "a mimic follows one",
        "couplings of a part of a joint": "revolute and prismatic joints can mimic each other",
        "particles": "URDF has rigid bodies only",
        "constraints that are not joints": (
            "URDF has joints, and Drake two points that coincide; a .toml file can hold it"
        ),
        "control characters in names": "rename it",
        "ellipsoids": "give it as a mesh, or as a capsule",
    },
    loses=(
        "parameters (their values stay)",
        "the plane (bodies stay in it)",
        "locks (the joints become fixed)",
        "frames (they become links)",
        "postures",
        "groups and ignored pairs",
        "notes",
        "which joints are actuated or cut",
        "the tolerance",
        "shapes that are seen and collide (they become a visual and a collision)",
    ),
)
"""The format of ROS; its links and joints form a tree, which elements of simulators close."""

TOML = Format(
    "TOML",
    (".toml",),
    partial(call_late_function, "read_toml"),
    partial(call_late_function, "write_toml"),
    recognises=lambda start: bool(re.match(r"format\s*=", start)),
    options=("package_dirs",),
    cannot={
        "joints of types that are not in the table of joints": "add the type to the table",
        "Python functions that are no expression": "write it as text",
        "expressions that are too long": "split it into several",
    },
)
"""The format of our own, which holds any mechanism."""

SDF = Format(
    "SDF",
    (".sdf", ".world"),
    partial(call_late_function, "read_sdf"),
    partial(call_late_function, "write_sdf"),
    elements=("sdf",),
    options=("base", "model", "lenient_limits", "package_dirs"),
    cannot={
        "loops that are open where all coordinates are zero": (
            "SDF places each link once, where all coordinates are zero, and has no value of a "
            "joint: choose the frames so that zero closes the loop, or save as .toml"
        ),
        "bodies that no joint carries": "join them to the ground",
        "joints of other types": (
            "SDF has revolute, prismatic, helical, universal and fixed joints, spherical ones by "
            "quaternion, free ones on the ground, and Drake planar ones"
        ),
        "limits of joints with several coordinates": "remove them, except those of universal joints",
        "locks of a part of a joint": "lock all of them, or none",
        "locks of coordinates that follow others": "lock what it follows",
        "couplings with several sources": "a mimic follows one",
        "couplings of a part of a joint": "joints with one coordinate can mimic each other",
        "particles": "SDF has rigid bodies only",
        "constraints that are not joints": "a .toml file can hold it",
        "names of its own, and equal ones": (
            "rename it: world and __...__ have a meaning, 'arm::hand' is a part of a nested model "
            "'arm', and a body, a joint, a frame and a nested model share no name"
        ),
        "parts of a nested model that are tied to parts outside": (
            "rename it: a nested model sees its own parts and the world only"
        ),
        "control characters in names": "rename it",
    },
    loses=(
        "parameters (their values stay)",
        "the plane (bodies stay in it)",
        "locks (the joints become fixed)",
        "the ground (it becomes a link that is fixed to the world)",
        "free joints on the ground (what nothing ties to the world moves freely; base='free' reads it "
        "so)",
        "postures",
        "notes",
        "which joints are actuated",
        "groups of joints and links",
        "the tolerance",
        "shapes that are seen and collide (they become a visual and a collision)",
    ),
)
"""The format of Gazebo, which Drake reads, too."""
MJCF = Format(
    "MJCF",
    (".mjcf",),
    partial(call_late_function, "read_mjcf"),
    elements=("mujoco", "mujocoinclude", "mjcf"),
    options=("package_dirs",),
)
"""The format of MuJoCo, which ties bodies by equalities; it is read through MuJoCo's compiler."""

FORMATS: dict[str, Format] = {"urdf": URDF, "toml": TOML, "sdf": SDF, "mjcf": MJCF}
"""The formats by name. Where several rows fit a file, the last counts: special rows stand after
general ones."""

DEFAULT = TOML
"""Format of a text that no row recognises, in a file whose ending no row has."""


@dataclass(frozen=True)
class OtherKind:
    """Kind of file that is no description of a mechanism, recognised by its first bytes."""

    what: str
    """What the file is, after 'this is'."""
    advice: str
    """What to do."""
    signature: bytes = rb"(?!)"
    """Regular expression that the beginning of the file matches, blanks left out."""
    elements: tuple[str, ...] = ()
    """Names of outermost elements of XML and HTML, in lower case, that tell the kind, too."""


HEAD = 4096
"""Bytes of a file by which its kind is recognised."""

_MESH = "a mesh has no joints: load the robot description that names this mesh"
_ARCHIVE = "unpack it, and load the robot description in it"
_PICTURE = "load the robot description, not a picture of it"
_TABLE = "load the robot description; kempe.map_file reads tables of configurations and targets"

OTHER_KINDS = (
    OtherKind(
        "a Git LFS pointer, which stands in place of the file",
        "run git lfs pull in the repository, or download the file itself",
        rb"version https://(git-lfs|hawser)\.github\.com/spec/",
    ),
    OtherKind(
        "a symbolic link that Git wrote as text",
        "load the file that it names",
        rb"(\.\.?/)+[^\s<>=\"'\\]+\s*\Z",
    ),
    OtherKind(
        "a web page (HTML)",
        "get the file itself: the page that shows a file on GitHub or GitLab has a button Raw or "
        "Download",
        rb"(?i:<!doctype\s+html\b)",
        ("html", "head", "body"),
    ),
    OtherKind(
        "an error message of a web server",
        "check the address of the download",
        rb"[45]\d\d: [A-Z]",
        ("error",),
    ),
    OtherKind(
        "a file compressed by gzip",
        "unpack it first: gunzip, or tar -xzf for an archive",
        rb"\x1f\x8b",
    ),
    OtherKind(
        "a file compressed by bzip2",
        "unpack it first: bunzip2, or tar -xjf for an archive",
        rb"BZh[1-9]1AY&SY",
    ),
    OtherKind(
        "a file compressed by xz",
        "unpack it first: unxz, or tar -xJf for an archive",
        rb"\xfd7zXZ\0",
    ),
    OtherKind("a file compressed by Zstandard", "unpack it first: unzstd", rb"\x28\xb5\x2f\xfd"),
    OtherKind("a ZIP archive", _ARCHIVE, rb"PK(\x03\x04|\x05\x06)"),
    OtherKind("a 7z archive", _ARCHIVE, rb"7z\xbc\xaf\x27\x1c"),
    OtherKind("a RAR archive", _ARCHIVE, rb"Rar!\x1a\x07"),
    OtherKind("a tar archive", _ARCHIVE, rb"(?=[^\0]{0,99}\0).{257}ustar[\0 ]"),
    OtherKind(
        "a USD scene (OpenUSD)",
        "Kempe does not read USD: load the URDF that it was made from, or export one",
        rb"#usda\s+\d|PXR-USDC",
    ),
    OtherKind(
        "a VRML file, as of a Webots world",
        "load the URDF that it was made from, or export one",
        rb"#VRML\w* V?R?\d",
    ),
    OtherKind("a COLLADA mesh", _MESH, elements=("collada",)),
    OtherKind("an STL mesh", _MESH, rb"solid\b[^\n]*\s+facet\s+normal\b"),
    OtherKind(
        "an OBJ mesh",
        _MESH,
        rb"((#|(mtllib|o|g|s)\s)[^\n]*\n\s*)*v\s+[-+.\d]+\S*\s+[-+.\d]+\S*\s+[-+.\d]",
    ),
    OtherKind("a PLY mesh", _MESH, rb"ply\s+format\s"),
    OtherKind("a glTF scene", _MESH, rb"glTF[\x01\x02]\0\0\0"),
    OtherKind("a STEP file of a CAD program", "export URDF from the CAD program", rb"ISO-10303-21"),
    OtherKind("a PDF document", "load the robot description", rb"%PDF-"),
    OtherKind("a PNG picture", _PICTURE, rb"\x89PNG\r\n"),
    OtherKind("a JPEG picture", _PICTURE, rb"\xff\xd8\xff"),
    OtherKind("a GIF picture", _PICTURE, rb"GIF8[79]a"),
    OtherKind("an SVG picture", _PICTURE, elements=("svg",)),
    OtherKind("an array of numpy (.npy)", _TABLE, rb"\x93NUMPY"),
    OtherKind("a Parquet table", _TABLE, rb"PAR1(?!\s*=)"),
    OtherKind("an HDF5 file", "load the robot description", rb"\x89HDF\r\n\x1a\n"),
    OtherKind(
        "a JSON file",
        "Kempe reads no JSON: load the robot description, or the file itself where this is the "
        "answer of a web service",
        rb"\{\s*(\"(\\.|[^\"\\])*\"\s*:|\}\s*\Z)",
    ),
    OtherKind(
        "a ROS launch file",
        "load the URDF that it names (often as robot_description)",
        elements=("launch",),
    ),
    OtherKind(
        "a ROS package manifest", "load a robot description of the package", elements=("package",)
    ),
)
"""Kinds of files that are no descriptions; none of the rows fits a text that a reader of Kempe
takes."""


def find_other_kind(data: str | bytes) -> OtherKind | None:
    """Return the kind of a file that is no description, by its first bytes; None if it may be one."""
    text = data[:HEAD] if isinstance(data, str) else decode_head(data)
    text = text.removeprefix("\ufeff").lstrip()
    head = (
        text.encode("utf-8", "replace")
        if isinstance(data, str) or data[:2] in UTF16_MARKS
        else data[:HEAD]
    )
    head = head.removeprefix(codecs.BOM_UTF8).lstrip()
    element = find_root_element(text).lower()
    return next(
        (k for k in OTHER_KINDS if element in k.elements or re.match(k.signature, head, re.DOTALL)),
        None,
    )


UTF16_MARKS = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def decode_head(data: bytes) -> str:
    """Return the beginning of a file as text, enough to recognise its format."""
    return data[:HEAD].decode("utf-16" if data[:2] in UTF16_MARKS else "utf-8", "replace")


def find_format_by_ending(name: str) -> Format | None:
    """Return the format of a file by the ending of its name; None where no format has this ending."""
    name = name.lower()
    return next((f for f in reversed(FORMATS.values()) if name.endswith(f.endings)), None)


def find_format_by_contents(start: str) -> Format | None:
    """Return the format of a text by its beginning; None where no format is recognised."""
    start = start.removeprefix("\ufeff").lstrip()
    name = find_root_element(start)
    rows = reversed(FORMATS.values())
    return next((f for f in rows if name in f.elements or f.recognises(start)), None)


def describe_root_fault(name: str) -> str:
    """Return the message about an outermost element that belongs to another format."""
    titles = [f.title for f in FORMATS.values() if name in f.elements]
    said = f": it is a file in {titles[0]}" if titles else ""
    return f"the outermost element is <{name}>{said}"


def join_titles(kinds: Iterable[Format], last: str = "or") -> str:
    """Return the titles of formats in words: 'URDF or TOML'."""
    return join_words([f.title for f in kinds], last)


def join_words(words: Iterable[str], last: str = "or") -> str:
    """Return words as an enumeration: 'a, b or c'."""
    *before, end = words
    return f"{', '.join(before)} {last} {end}" if before else end


def list_readable_formats(option: str = "") -> list[Format]:
    """Return the formats that have a reader; with `option`, those whose reader accepts the option."""
    return [f for f in FORMATS.values() if f.read and (not option or option in f.options)]


def list_writable_endings() -> str:
    """Return the endings of the file names that can be written, in words."""
    return join_words([ending for f in FORMATS.values() if f.write for ending in f.endings])
