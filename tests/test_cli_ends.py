"""How commands end: by Ctrl-C with what was done, by the time limit, and at once where a file is
none.
"""

from __future__ import annotations

import itertools
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from command import Result

import kempe
from kempe import arguments
from kempe.description.read import check_description, read_mechanism, write_mechanism
from kempe.description.xacro import expand_xacro
from kempe.errors import DescriptionError, InputError

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals, FIFOs")

HAND = "panda_hand_tcp"
STARTED = "import signal, sys\nsignal.signal(signal.SIGINT, signal.default_int_handler)\n"


def command(*words: object, before: str = "") -> list[str]:
    """A command line that runs kempe, after some lines of Python, with Ctrl-C as in a terminal."""
    code = (
        STARTED
        + before
        + f"sys.argv[1:] = {[str(w) for w in words]!r}\nfrom kempe.cli import main\nmain()\n"
    )
    return [sys.executable, "-c", code]


def at_call(path: str, number: int) -> str:
    """Lines of Python by which a function sends Ctrl-C to its own process when it is called for the
    n-th time.
    """
    module, _, name = path.rpartition(".")
    return (
        f"import os, itertools, pkgutil\nmodule = pkgutil.resolve_name({module!r})\n"
        f"own, count = module.{name}, itertools.count(1)\n"
        "def counted(*given, **more):\n"
        f"    if next(count) == {number}:\n        os.kill(os.getpid(), signal.SIGINT)\n"
        "    return own(*given, **more)\n"
        f"module.{name} = counted\n"
    )


def run(words: list[str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(words, capture_output=True, text=True, timeout=300)


# ---- an output that nobody reads


@pytest.mark.parametrize("words", ["fk puma560", "fk puma560 --json", "fk --help", "--version"])
def test_a_command_ends_quietly_where_its_reader_has_ended(words):
    """As `kempe ... | head -1`: 128 + SIGPIPE, as other programs."""
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(command(*words.split()), stdout=writer, stderr=subprocess.PIPE)
    os.close(writer)
    assert (done.returncode, done.stderr) == (128 + signal.SIGPIPE, b"")


# ---- Ctrl-C


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.slow
def test_a_path_of_targets():
    robot = kempe.load("panda")
    q = robot.q("ready") + 0.2 * np.linspace(0.0, 1.0, 200)[:, None]
    np.save("way.npy", robot.fk(q, HAND))
    words = f"path panda --frame {HAND} --targets way.npy --out q.csv --start"
    stop = at_call("kempe.kernels.compiled.path_steps.follow_targets", 2)
    done = run(command(*words.split(), ",".join(map(str, q[0])), before=stop))
    assert done.returncode == 130 and "interrupted" in done.stdout, done.stderr
    rows = np.loadtxt("q.csv", delimiter=",", skiprows=1)
    assert np.isfinite(rows[:60]).all() and not np.isfinite(rows[-1]).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("where", "number", "words"),
    [
        ("kempe.motion.trace.find_return", 2, "trace four_bar"),
        ("kempe.motion.trace.find_extreme", 2, "trace four_bar"),
        ("kempe.motion.path.run_many_gauss_newton", 5, "trace four_bar --points 30000"),
    ],
)
def test_a_traced_motion(where, number, words):
    """While it is followed, while special points are looked for, and while points at equal
    distances are made.
    """
    done = run(command(*words.split(), "-o", "path.csv", before=at_call(where, number)))
    assert done.returncode == 130 and "interrupted" in done.stdout, done.stderr
    assert "Traceback" not in done.stderr
    rows = np.loadtxt("path.csv", delimiter=",", skiprows=1, ndmin=2)
    s = kempe.load("four_bar")
    assert len(rows) and np.abs(s.loops.closure_error(rows[:, 1 : 1 + s.nq])).max() < 1e-9


@pytest.mark.slow
def test_assembly_modes():
    stops = ("estimate_share_found", "mix_configurations")
    before = "".join(at_call(f"kempe.assemble.modes.{name}", 1) for name in stops)
    done = run(command("assemble", "rssr", "A=0.4", "--modes", "-o", "modes.csv", before=before))
    assert done.returncode == 130 and "interrupted" in done.stdout, (done.stdout, done.stderr)


COUNTED = """
import itertools, math, types, kempe.numerics.clock, kempe.motion.path as module
own, count = module.run_many_gauss_newton, itertools.count(1)
def counted(*given, **more):
    n = next(count)
    {then}
    return own(*given, **more)
module.run_many_gauss_newton = counted
"""
"""What happens at the n-th piece of points at equal distances."""
SAYS = COUNTED.format(
    then="if n == 5: print('begun', flush=True)\n    while n == 20: signal.pause()"
)
"""The process says when some are done, and soon after that it waits for the signal."""
LATE = COUNTED.format(
    then=(
        "if n == 10: kempe.numerics.clock.time = types.SimpleNamespace(monotonic=lambda: math.inf)"
    )
)
"""The time is up when some are done."""
MILLION = "trace four_bar --points 1000000 -o path.csv".split()


@pytest.mark.slow
def test_a_signal_from_outside():
    """Ctrl-C from a terminal, at whatever it does then."""
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command(*MILLION, before=SAYS), **pipes, text=True) as process:
        assert process.stdout is not None and process.stdout.readline() == "begun\n"
        process.send_signal(signal.SIGINT)
        said, wrong = process.communicate(timeout=300)
    assert process.returncode == 130 and "interrupted" in said, (said, wrong)
    assert "Traceback" not in wrong
    assert len(Path("path.csv").read_text(encoding="utf-8").splitlines()) > 100


@pytest.mark.slow
def test_a_time_limit_leaves_what_was_done():
    done = run(command(*MILLION, "--time-limit", 1000, before=LATE))
    assert done.returncode == 1 and "stopped by the time limit" in done.stdout, done.stderr
    assert "of 1000000 points at equal distances" in " ".join(done.stdout.split())
    assert len(Path("path.csv").read_text(encoding="utf-8").splitlines()) > 10


# ---- what is no file


def odd_files(folder: Path, ending: str) -> dict[str, Path]:
    """A FIFO, a folder, a socket and a device, as far as there are any."""
    import socket

    found = {
        "FIFO": folder / f"fifo{ending}",
        "folder": folder / f"folder{ending}",
        "device": Path("/dev/zero"),
    }
    os.mkfifo(found["FIFO"])
    found["folder"].mkdir()
    here = Path.cwd()
    os.chdir(folder)  # names of sockets are short
    try:
        with socket.socket(socket.AF_UNIX) as s:
            s.bind(f"socket{ending}")
        found["socket"] = folder / f"socket{ending}"
    finally:
        os.chdir(here)
    return {k: v for k, v in found.items() if v.exists()}


@pytest.mark.parametrize("ending", [".urdf", ".toml", ".urdf.xacro"])
def test_what_is_no_file_is_not_read(tmp_path, ending):
    for what, path in odd_files(tmp_path, ending).items():
        with pytest.raises(DescriptionError, match=f"this is a {what}"):
            read_mechanism(path, xacro=ending.endswith("xacro"))
        assert f"this is a {what}" in str(check_description(path).problems[0])


def test_what_is_no_file_is_not_written(tmp_path):
    mechanism = kempe.read("four_bar")
    for what, path in odd_files(tmp_path, ".toml").items():
        if path.suffix == ".toml":
            with pytest.raises(InputError, match=f"this is a {what}"):
                write_mechanism(mechanism, path)


@pytest.mark.parametrize(
    "words",
    [
        "info f.urdf",
        "fk puma560 --q f.csv",
        "ik puma560 --frame tool --target f.csv",
        "ik puma560 --tasks f.toml",
        "path puma560 --frame tool --targets f.npy",
        "assemble four_bar f.csv",
        "fk puma560 -o f.csv",
        "trace four_bar --plot f.svg",
        "convert four_bar f.toml",
        "trace four_bar -o f.npy",
    ],
)
def test_commands_refuse_a_fifo_at_once(words):
    for ending in ("urdf", "csv", "npy", "toml", "svg"):
        os.mkfifo(f"f.{ending}")

    def fail(*_):
        raise AssertionError("it waits for the FIFO")

    before = signal.signal(signal.SIGALRM, fail)
    signal.alarm(300)
    try:
        done = Result(*words.split())
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
    assert done.code == 2 and "this is a FIFO" in " ".join(done.err.split()), done.err


# ---- xacro


@pytest.mark.slow
@pytest.mark.parametrize("text", ["time.sleep(600)", "9**9**9**9"])
def test_an_expansion_ends_when_its_message_says(text, tmp_path, monkeypatch):
    """It waits for something else than the processor; and what asks for ever larger numbers."""
    (tmp_path / "xacrodoc.py").write_text(
        "import time\nfrom unittest.mock import MagicMock\npackages = MagicMock()\n"
        "class XacroDoc:\n    def from_file(path, **_):\n        eval(open(path).read())\n",
        encoding="utf-8",
    )
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    path = tmp_path / "bomb.xacro"
    path.write_text(text, encoding="utf-8")
    waited: list[float] = []
    wait = subprocess.Popen.wait

    def waits(process, timeout=None, waited=waited, wait=wait):
        waited.append(timeout)
        return wait(process, timeout)

    monkeypatch.setattr(subprocess.Popen, "wait", waits)
    with pytest.raises(DescriptionError, match=r"did not finish in 1\.5 s"):
        expand_xacro(path, seconds=1.5)
    assert max(t for t in waited if t is not None) == 1.5
    monkeypatch.setattr(subprocess.Popen, "wait", wait)


# ---- mistakes, and numbers that are no numbers


@pytest.mark.parametrize(
    "words",
    [("{long}",), ("fk", "two_link", "--{long}"), ("info", "two_link", "--plot", "{long}.png")],
)
@pytest.mark.parametrize("json", [False, True])
def test_long_words_do_not_make_long_messages(words, json):
    done = Result(*(w.format(long="p" * 100_000) for w in words), *(["--json"] if json else []))
    assert done.code == 2 and 0 < len(done.err + done.out) < 3000


@pytest.mark.slow
@pytest.mark.parametrize("columns", ["0", "1", "-7", "99999999999", "9" * 5000, "wide", "\u0663"])
def test_help_is_whole_in_any_width(columns):
    """A width of 0 printed nothing, and a wide one took all memory."""
    environment = {**os.environ, "COLUMNS": columns, "TERMINAL_WIDTH": ""}
    done = subprocess.run(
        command("fk", "--help"), capture_output=True, text=True, timeout=300, env=environment
    )
    assert done.returncode == 0 and "--posture" in done.stdout and "Traceback" not in done.stderr, (
        done.stderr
    )


def test_names_of_files_with_a_zero_byte_are_refused(tmp_path):
    """They ended in a ValueError of the operating system's interface."""
    robot = kempe.load("two_link")
    name = f"{tmp_path}/a\0b"
    answer = robot.ik([0.6, 0.3, 0.0], "e")
    for call in (
        lambda: answer.save(f"{name}.csv"),
        lambda: robot.save_html(f"{name}.html"),
        lambda: kempe.open_workspace(name),
        lambda: robot.workspace("e", n=1000, path=name),
        lambda: kempe.map_file(robot, "fk", f"{name}.csv", name, "e"),
        lambda: kempe.load(name),
    ):
        with pytest.raises(InputError, match="holds a zero byte"):
            call()


def test_lists_of_names_and_budgets_are_read_to_an_end(tmp_path, monkeypatch):
    """A list of names that is made while it is read took all memory; a time of 10**400 s raised
    OverflowError.
    """
    monkeypatch.setattr(arguments, "MOST_NAMES", 100)
    robot = kempe.load("two_link")
    np.save(tmp_path / "q.npy", np.zeros((3, 2)))
    with pytest.raises(InputError, match="columns has more than 100 names"):
        kempe.map_file(
            robot,
            "fk",
            tmp_path / "q.npy",
            tmp_path / "x.zarr",
            "e",
            columns=itertools.repeat("q1"),
        )
    assert robot.ik([0.6, 0.3, 0.0], "e", budget=kempe.Budget(time_limit=10**400))
    with pytest.raises(InputError, match="progress is 3"):
        robot.singularities("e", budget=kempe.Budget(progress=3))
