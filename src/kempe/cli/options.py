"""Options and arguments that several commands share, each declared once."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from kempe.description.formats import join_titles, list_readable_formats


def make_option(flags: str, help: str, metavar: str | None = None, panel: str | None = None) -> Any:
    """Return an option of a command; without `metavar` the option is a switch without a value."""
    return typer.Option(*flags.split(","), help=help, metavar=metavar or "", rich_help_panel=panel)


# ---- how FILE is read

_READ = "How FILE is read"
File = Annotated[
    str,
    typer.Argument(
        metavar="FILE",
        help=f"File in {join_titles(list_readable_formats())}, or a shipped model's name.",
    ),
]
_FREE = (
    "'free': bodies that no joint connects to the ground move freely "
    f"({join_titles(list_readable_formats('base'))})."
)
Base = Annotated[str | None, make_option("--base", _FREE, "free", _READ)]
Root = Annotated[
    str | None,
    make_option("--root", "Link to take as root, if FILE does not determine it.", "LINK", _READ),
]
_MODEL = (
    f"The model to read where FILE has several ({join_titles(list_readable_formats('model'))})."
)
Model = Annotated[str | None, make_option("--model", _MODEL, "NAME", _READ)]
_FOLDER = "Folder with packages or meshes; can be repeated."
PackageDirs = Annotated[list[Path] | None, make_option("--package-dir", _FOLDER, "FOLDER", _READ)]
Xacro = Annotated[
    bool,
    make_option(
        "--xacro",
        "Expand xacro first. It runs a program: use it only for files that you trust.",
        None,
        _READ,
    ),
]
_ARGUMENT = "Value of a <xacro:arg> of FILE, which is then expanded; can be repeated."
XacroArguments = Annotated[
    list[str] | None, make_option("--xacro-arg", _ARGUMENT, "NAME=VALUE", _READ)
]
_LENIENT = (
    "Ignore limits without a range (no bounds, or lower above upper) and negative limits of effort "
    f"({join_titles(list_readable_formats('lenient_limits'))})."
)
Lenient = Annotated[bool, make_option("--lenient-limits", _LENIENT, None, _READ)]
_SRDF = "SRDF of the robot: groups, postures, end effectors, how the base moves."
SrdfFile = Annotated[Path | None, make_option("--srdf", _SRDF, "FILE", _READ)]
_UNIT = "Unit of all lengths, read and printed: m, cm, mm or in (default: that of FILE)."
LengthUnit = Annotated[str | None, make_option("--unit", _UNIT, "UNIT", _READ)]


# ---- how a command answers

Json = Annotated[bool, make_option("--json", "Print JSON.")]
Deg = Annotated[
    bool, make_option("--deg", "Angles are degrees, read and printed; for lengths see --unit.")
]
Out = Annotated[
    Path | None, make_option("-o,--out", "Write the results to a .csv or .npy file.", "FILE")
]
InPlace = Annotated[
    Path | None, make_option("-o,--out", "The file to write, in place of OUT.", "FILE")
]
Picture = Annotated[
    Path | None, make_option("--plot", "Draw a .png, .svg or .pdf file (needs matplotlib).", "FILE")
]
Film = Annotated[
    Path | None, make_option("--gif,--mp4", "Write the motion as a .gif or .mp4 file.", "FILE")
]
Page = Annotated[
    Path | None,
    make_option("--html", "Write an interactive page that needs no network.", "FILE"),
]


# ---- how much work a command does

TimeLimit = Annotated[
    float | None,
    make_option(
        "--time-limit", "Seconds after which the command ends with the result so far.", "SECONDS"
    ),
]
Rng = Annotated[int | None, make_option("--rng", "Seed of the random numbers (0).", "N")]
Starts = Annotated[int | None, make_option("--starts", "Random starts of the search (64).", "N")]
Threads = Annotated[
    int | None, make_option("--threads", "Threads; all processors if not given.", "N")
]
Scheduler = Annotated[
    str | None, make_option("--scheduler", "Address of the scheduler of a Dask cluster.", "ADDRESS")
]


# ---- what the question is about

_ABOUT = make_option("--frame", "Body or frame of the robot that the command is about.", "NAME")
Frame = Annotated[str | None, _ABOUT]
OneFrame = Annotated[str, _ABOUT]
FrameOrAll = Annotated[
    str | None, make_option("--frame", "Body or frame; without it, fk computes all bodies.", "NAME")
]
Frames = Annotated[
    list[str] | None,
    make_option(
        "--frame", "Body or frame whose axes or curve are wanted; can be repeated.", "NAME"
    ),
]
_VALUES = (
    "a,b,c, or name=value,... (loops are closed around these), or a .csv or .npy file, one "
    "configuration a row."
)
Values = Annotated[str | None, make_option("--q", _VALUES, "VALUES")]
Posture = Annotated[
    str | None,
    make_option(
        "--posture", "A posture of FILE, 'neutral' or 'mid'; --q name=value changes it.", "NAME"
    ),
]
Start = Annotated[
    str | None,
    make_option(
        "--start,--near,--seed",
        "Start of the search: a posture, or values as for --q of fk.",
        "START",
    ),
]
Hold = Annotated[
    list[str] | None, make_option("--hold", "Hold a coordinate; can be repeated.", "NAME=VALUE")
]
NoLimits = Annotated[bool, make_option("--no-limits", "Ignore joint limits.")]
_ROWS = "x,y,z,roll,pitch,yaw (fixed axes) or x,y,z; or a .csv or .npy file, a target a row."
Target = Annotated[str | None, make_option("--target,--targets", _ROWS, "VALUES")]
Poses = Annotated[
    str,
    typer.Argument(metavar="POSES", help="A .csv or .npy file, a pose a row, as targets of ik."),
]
TaskFile = Annotated[
    Path | None,
    make_option(
        "--tasks", "Several tasks in place of a frame and its target: a .toml file.", "FILE"
    ),
]
Task = Annotated[
    str | None,
    make_option(
        "--task",
        "Part of the target to reach: pose, position, orientation, direction or position_axis.",
        "TASK",
    ),
]
Axis = Annotated[
    str | None,
    make_option("--axis", "Axis of the tool for the last two tasks: z, -x or x,y,z (z).", "AXIS"),
]
Clearance = Annotated[
    float | None,
    make_option("--clearance", "Distance that all bodies keep, by their collision shapes.", "X"),
]
PositionOnly = Annotated[bool, make_option("--position-only", "Leave the orientation free.")]
Tolerance = Annotated[
    str | None,
    make_option(
        "--tolerance",
        "Largest errors accepted, in the unit of FILE and radians (1e-6 m; --all 1e-9 m; a path 1e-10 m).",
        "M[,RAD]",
    ),
]
Dimensions = Annotated[
    str | None,
    make_option(
        "--tolerance",
        "Tolerance of the dimensions, in the unit of FILE and radians, or 'measured'.",
        "NUMBER",
    ),
]
