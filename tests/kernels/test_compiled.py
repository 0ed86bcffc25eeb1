"""Entry points of kernels: the library is found, fits, is never stale, and refuses what it cannot
take.
"""

from __future__ import annotations

import os
import pickle
import re
import signal
import subprocess
import sys
import threading
from importlib.util import find_spec
from typing import Any

import numpy as np
import pytest
from copies import BLOCKED, ROOT, copied, printed, run
from hunts import examples, some
from hypothesis import given, settings
from hypothesis import strategies as st

import kempe
from kempe.kernels import compiled
from kempe.kernels.digest import compute_source_digests
from kempe.kernels.forward.table_layout import fuse_table

native = pytest.mark.skipif(
    compiled.VARIANT == compiled.JIT, reason="kernels are compiled in this process"
)
with_numba = pytest.mark.skipif(find_spec("numba") is None, reason="Numba is not installed")

SLIDER = """
import kempe
m = kempe.Mechanism("m"); m.prismatic("j", m.ground, m.body("b"), axis=(0, 0, 1))
print(m.build().fk([0.5], "b")[2, 3])
"""


VERBS = """
import kempe
puma, jaco, bar = (kempe.load(name) for name in ("puma560", "jaco2", "four_bar"))
q = puma.q({"q2": 0.8, "q3": -2.9, "q5": 0.6})
X, hand = puma.fk(q, "tool"), jaco.frame_names[-1]
puma.jacobian(q, "tool"), puma.fk(q)
assert puma.ik(X, "tool") and len(puma.ik_all(X, "tool")) == 8
assert puma.ik([kempe.tasks.Position("tool", X[:3, 3])], prefer=lambda q: float(q @ q))
assert puma.ik_step(q, [0, 0, 0.1, 0, 0, 0], "tool", 0.01) and puma.ik_path(X[None], "tool")
assert len(jaco.ik_all(jaco.fk(jaco.random(1), hand), hand))
assert bar.assemble({"A": 1.0}) and len(bar.assembly_modes({"A": 1.0})) == 2
assert bar.mobility().dof == 1 and bar.trace("A")
print([name for name in sys.modules if name.startswith("kempe.kernels.")])
"""


# ------------------------------------------------------------------ what is loaded


@pytest.mark.slow
@native
def test_every_verb_runs_without_numba_and_without_the_sources_of_kernels():
    kernels = ROOT / "src" / "kempe" / "kernels"
    loaded = set(re.findall(r"kempe\.kernels\.([\w.]+)", printed(BLOCKED + VERBS)))
    data = {
        f"{path.parent.name}.{path.stem}"
        for name in ("layout", "constants")
        for path in kernels.glob(f"*/*{name}.py")
    }
    assert loaded <= data | {name.partition(".")[0] for name in data} | {
        "compiled",
        "digest",
        "_native",
    }


OUTSIDE = [p for p in sorted((ROOT / "src" / "kempe").rglob("*.py")) if "kernels" not in p.parts]


@pytest.mark.parametrize("path", OUTSIDE, ids=lambda p: p.stem)
def test_sources_of_kernels_are_for_the_compiler_only(path):
    """No module outside `kernels` imports another module of it than `compiled`, layouts, and
    constants.
    """
    pattern = re.compile(
        r"^\s*(?:from|import) kempe\.kernels(?:\.(\w+))?(?: import |\.)(\w+)", re.M
    )
    for folder, name in pattern.findall(path.read_text()):
        assert "compiled" in (folder, name) or re.fullmatch(r"\w*(layout|constants)", name), (
            f"{path.name} imports {name}"
        )


@native
def test_the_library_is_that_of_the_sources():
    assert compiled._native.SOURCES == compute_source_digests()
    assert (
        compiled.VARIANT in compiled._native.VARIANTS
        and compiled._native.VARIANTS[compiled.VARIANT]
    )


# ------------------------------------------------------------------ nothing stale


@pytest.fixture
def edited(tmp_path):
    """A copy of the package in which a helper of all forward models takes slides twice as long."""
    package = copied(tmp_path)
    helper = package / "kernels" / "forward" / "table_sweep.py"
    text = helper.read_text()
    assert text.count("prepend_slide(multiplier * q[index], c)") == 1
    helper.write_text(
        text.replace(
            "prepend_slide(multiplier * q[index], c)",
            "prepend_slide(2.0 * multiplier * q[index], c)",
        )
    )
    return package


@pytest.mark.slow
@native
@with_numba
def test_an_edited_helper_is_compiled_anew_and_that_is_said_once(edited):
    assert printed(SLIDER) == "0.5"
    done = run(SLIDER, edited)
    assert done.stdout.strip() == "1.0"
    assert done.stderr.count("kempe:") == 1 and "edited after they were compiled" in done.stderr
    assert printed(SLIDER, edited, KEMPE_QUIET="1") == "1.0"


@pytest.mark.slow
@native
def test_an_edited_helper_is_an_error_where_it_cannot_be_compiled(edited):
    done = run(BLOCKED + SLIDER, edited)
    assert done.returncode and "KernelsError" in done.stderr and "pip install -e ." in done.stderr
    done = run(SLIDER, edited, KEMPE_KERNELS=compiled.VARIANT)
    assert (
        done.returncode and f"KEMPE_KERNELS is '{compiled.VARIANT}', but the sources" in done.stderr
    )


@pytest.mark.slow
@native
@pytest.mark.parametrize("change", some(["new file", "renamed", "removed"], 3))
def test_each_change_of_the_sources_is_seen(tmp_path, change):
    package = copied(tmp_path)
    assert printed(BLOCKED + SLIDER, package) == "0.5"
    some = package / "kernels" / "closed_form" / "subproblems.py"
    if change == "new file":
        some.with_name("more.py").write_text("")
    else:
        some.rename(some.with_name("renamed.py")) if change == "renamed" else some.unlink()
    name = {"new file": "more.py", "renamed": "renamed.py", "removed": "subproblems.py"}[change]
    assert (
        f"edited after they were compiled (closed_form/{name})"
        in run(BLOCKED + SLIDER, package).stderr
    )


@native
def test_what_editors_leave_behind_does_no_harm(tmp_path):
    package = copied(tmp_path)
    kernels = package / "kernels"
    (kernels / ".#sweep.py").symlink_to("me@host.1")
    (kernels / "sweep (copy).py").write_text("")
    (kernels / "folder.py").mkdir()
    assert printed(BLOCKED + SLIDER, package) == "0.5"


@pytest.mark.slow
@native
def test_a_package_without_sources_runs_what_it_has(tmp_path):
    package = copied(tmp_path)
    subprocess.run([sys.executable, "-m", "compileall", "-q", "-b", package], check=True)
    for path in package.rglob("*.py"):
        path.unlink()
    assert printed(BLOCKED + SLIDER, package) == "0.5"


@pytest.mark.slow
@native
def test_without_a_library_the_error_says_what_to_do(tmp_path):
    package = copied(tmp_path)
    for library in (package / "kernels").glob("_native*"):
        library.unlink()
    error = run(BLOCKED + SLIDER, package).stderr
    assert "not compiled" in error and "a wheel of Kempe for this platform" in error
    (package / "kernels" / "_native.abi3.so").write_bytes(b"no library")
    error = run(BLOCKED + SLIDER, package).stderr
    assert (
        "KernelsError: the library of kernels cannot be loaded" in error
        and "KEMPE_KERNELS=jit" in error
    )


@pytest.mark.parametrize("name", ["v5", "V4", " ", "native"])
def test_unknown_variants_are_refused_with_what_is_allowed(name):
    error = run(SLIDER, KEMPE_KERNELS=name).stderr
    assert f"KEMPE_KERNELS is {name!r}" in error and (
        "allowed here: " in error or "not compiled" in error
    )


def test_the_version_is_reported_even_without_kernels():
    done = run(
        "from kempe.cli import main; import sys; sys.argv[1:] = ['--version']; main()",
        KEMPE_KERNELS="v9",
    )
    assert done.returncode == 2 and done.stdout == f"kempe {kempe.__version__}\n"
    assert done.stderr.startswith("error: KEMPE_KERNELS is 'v9'") and "Traceback" not in done.stderr


def test_jit_without_numba_says_so():
    assert (
        "KEMPE_KERNELS is 'jit', but there is no Numba"
        in run(BLOCKED + SLIDER, KEMPE_KERNELS="jit").stderr
    )


@pytest.mark.slow
@with_numba
def test_compiled_in_the_process_on_request():
    assert printed(
        SLIDER + "print(kempe.kernels.compiled.VARIANT)", KEMPE_KERNELS="jit"
    ).split() == ["0.5", "jit"]


# ------------------------------------------------------------------ the C layer

ROWS = re.compile(r"(\w+): ([fib])(?:\[([^]]*)\])?(!?)")


def entry_points() -> dict[str, tuple[Any, list[tuple[str, str, list[str], bool]]]]:
    """Each entry point with its arguments: name, kind of entries, lengths of axes, whether it is
    written.
    """
    found = {}
    for name in dir(compiled._native):
        entry = getattr(compiled._native, name)
        if "__" in name.strip("_"):
            rows = ROWS.findall(entry.__doc__.partition("(")[2])
            found[name] = (
                entry,
                [(a, k, s.split(", ") if s else [], bool(w)) for a, k, s, w in rows],
            )
    return found


ENTRY_POINTS = entry_points() if compiled.VARIANT != compiled.JIT else {}


def good(kind: str, lengths: list[str], sizes: dict[str, int]) -> Any:
    """An argument as it is declared; axes with a letter get its length, others one that fits."""
    if not lengths:
        return {"f": 0.5, "i": 1, "b": True}[kind]

    def length(text: str) -> int:
        letter, _, more = text.rpartition("|")[2].partition("+")
        return int(letter) if letter.isdigit() else sizes.setdefault(letter, 3) + int(more or 0)

    return np.zeros([length(x) for x in lengths], dtype={"f": float, "i": np.int64}[kind])


def spoilt(argument: Any, how: str) -> Any:
    """The argument, made unfit."""
    if not isinstance(argument, np.ndarray):
        return "1" if how != "none" else None
    if how == "none":
        return None
    if how == "list":
        return argument.tolist()
    if how == "axes":
        return argument[None]
    if how == "type":
        return argument.astype(np.float32 if argument.dtype == float else np.int32)
    if how == "other":
        return argument.astype(np.int64 if argument.dtype == float else float)
    if how == "order":
        return argument.view(argument.dtype.newbyteorder())
    if how == "aligned":
        raw = np.zeros(argument.nbytes + 1, dtype=np.uint8)
        return raw[1:].view(argument.dtype).reshape(argument.shape)
    wide = np.zeros([2 * n for n in argument.shape], dtype=argument.dtype)  # how == "strides"
    return wide[tuple(slice(None, None, 2) for _ in argument.shape)]


def ways(kind: str, size: int) -> list[str]:
    """How an argument can be unfit: anything has a truth value, one number lies anywhere."""
    apart = ["aligned", "strides"] if size > 1 else []
    return [] if kind == "b" else ["none", "list", "axes", "type", "other", "order", *apart]


@native
@pytest.mark.parametrize("name", ENTRY_POINTS)
def test_what_does_not_fit_is_refused_and_named(name):
    """Each argument of each entry point in each wrong way; nothing is run, nothing converted."""
    entry, rows = ENTRY_POINTS[name]
    for k, (argument, kind, lengths, _) in enumerate(rows):
        for how in ways(kind, np.size(good(kind, lengths, {}))):
            given = [good(kind_, lengths_, {}) for _, kind_, lengths_, _ in rows]
            given[k] = spoilt(given[k], how)
            with pytest.raises(TypeError) as caught:
                entry(*given)
            assert not isinstance(given[k], np.ndarray) or f": {argument} must be " in str(
                caught.value
            )
    for count in (0, len(rows) - 1, len(rows) + 1):
        with pytest.raises(TypeError, match=f"takes {len(rows)} arguments, not {count}"):
            entry(*[0] * count)


@native
@pytest.mark.parametrize("name", ENTRY_POINTS)
def test_what_is_written_must_be_writable(name):
    entry, rows = ENTRY_POINTS[name]
    for k, (argument, _, _, written) in enumerate(rows):
        if written:
            given = [good(kind_, lengths_, {}) for _, kind_, lengths_, _ in rows]
            given[k].setflags(write=False)
            with pytest.raises(TypeError, match=f"{argument} must be a writable"):
                entry(*given)


@native
@pytest.mark.parametrize("name", ENTRY_POINTS)
def test_lengths_that_differ_are_refused_and_named(name):
    entry, rows = ENTRY_POINTS[name]
    written = [x for _, _, lengths, _ in rows for x in lengths]
    uses = [x.rpartition("|")[2].partition("+")[0] for x in written]
    measured = [x.isdigit() or (x != "_" and uses.count(x) > 1) for x in uses]
    axes = [
        (k, argument, axis)
        for k, (argument, _, lengths, _) in enumerate(rows)
        for axis in range(len(lengths))
    ]
    for place, (k, argument, axis) in enumerate(axes):
        if measured[place]:
            given = [good(kind_, lengths_, {}) for _, kind_, lengths_, _ in rows]
            given[k] = np.zeros(
                [n + 7 * (j == axis) for j, n in enumerate(given[k].shape)], dtype=given[k].dtype
            )
            with pytest.raises(ValueError, match=r"axis \d of \w+ has length") as caught:
                entry(*given)
            judge = uses[place] in written and written.index(uses[place]) == place
            # where the others are measured by it, they are named
            assert judge or argument in str(caught.value)


@pytest.mark.slow
@native
@given(st.data())
@settings(max_examples=examples(300))
def test_no_sequence_of_arguments_ends_the_process(data):
    """Wrong in several places at once, from a list of unsuitable objects."""
    name = data.draw(st.sampled_from(sorted(ENTRY_POINTS)))
    entry, rows = ENTRY_POINTS[name]
    given_ = [good(kind, lengths, {}) for _, kind, lengths, _ in rows]
    arrays = [k for k, row in enumerate(rows) if row[2]]
    odd = [
        None,
        "x",
        b"x",
        1.5,
        -1,
        2**70,
        float("nan"),
        [],
        {},
        np.zeros(()),
        np.zeros(0),
        np.zeros(3, "O"),
        np.zeros((2, 2), "M8[s]"),
        np.ma.zeros(3),
        np.float64(1),
        object(),
        np.zeros((0, 0, 0)),
        entry,
    ]
    for k in data.draw(st.sets(st.sampled_from(arrays), min_size=1)):
        right = given_[k]
        unfit = [
            x
            for x in odd
            if not isinstance(x, np.ndarray) or x.dtype != right.dtype or x.ndim != right.ndim
        ]
        given_[k] = data.draw(st.sampled_from(unfit))
    for k in data.draw(st.sets(st.integers(0, len(rows) - 1))) - set(arrays):
        given_[k] = data.draw(st.sampled_from(odd))
    with pytest.raises((TypeError, ValueError, OverflowError)):
        entry(*given_)


def one_frame() -> tuple[np.ndarray, np.ndarray]:
    """A fused table of one frame that nothing moves, and its empty configuration."""
    ints = np.zeros(10, dtype=np.int64)
    ints[1] = 1
    ints[8] = -1
    return fuse_table(ints, np.eye(3, 4).ravel()), np.empty(0)


@pytest.mark.parametrize("writeable", [True, False])
def test_read_only_inputs_pass(writeable):
    table, q = one_frame()
    table.setflags(write=writeable)
    out = np.empty((4, 4))
    assert compiled.bound.compute_pose(table, q, out) == 0 and np.array_equal(out, np.eye(4))


@native
def test_subclasses_are_left_to_those_who_call():
    """A subclass may hold what its numbers alone do not say, a mask or a unit."""

    class Mine(np.ndarray):
        pass

    table, q = one_frame()
    with pytest.raises(TypeError, match="table must be"):
        compiled.bound.compute_pose(table.view(Mine), q, np.empty((4, 4)))


@native
def test_calls_keep_no_references():
    table, q = one_frame()
    out = np.empty((4, 4))
    many = np.empty((3, 4, 4))
    none = np.empty((3, 0))
    ints = np.array([0, 1, 0, 0, 0, 0, 0, 0, -1, 0])
    floats = np.eye(3, 4).ravel()
    kept = (table, q, out, many, none, ints, floats)
    before = [sys.getrefcount(x) for x in kept]
    for _ in range(1000):
        assert compiled.bound.compute_pose(table, q, out) == 0
        assert compiled.table_sweep.compute_poses(ints, floats, none, many[:, None]) == 0
        with pytest.raises(TypeError):
            compiled.bound.compute_pose(table, q, None)
        with pytest.raises(TypeError):
            compiled.bound.compute_pose(table, q, out.T)
        with pytest.raises(ValueError, match="axis 0 of out"):
            compiled.table_sweep.compute_poses(ints, floats, none, np.empty((2, 1, 4, 4)))
    assert [sys.getrefcount(x) for x in kept] == before


@native
def test_scratch_that_does_not_fit_into_memory_is_a_memory_error():
    ints = np.zeros(10, dtype=np.int64)
    ints[0] = 2**57  # rows, for which scratch is allocated before they are read
    with pytest.raises(MemoryError):
        compiled.table_sweep.compute_single_poses(
            ints, np.zeros(12), np.empty(0), np.empty((1, 4, 4))
        )


def test_made_arrays_are_ordinary_ones():
    for shape in ((), (0,), (4, 4), (1, 2, 3)):
        made = compiled.make_allocator(*shape)()
        assert (
            made.shape == shape
            and made.dtype == float
            and made.flags.owndata
            and made.flags.c_contiguous
        )
    new = compiled.make_allocator(2)
    assert new() is not new()
    for wrong in ((-1,), ("a",), (1.5,), (1,) * 9 + (-1,)):
        with pytest.raises((TypeError, ValueError)):
            compiled.make_allocator(*wrong)()


def test_answers_of_plain_calls_can_be_pickled():
    robot = kempe.load("puma560")
    X = robot.fk(robot.q({"q2": 0.8, "q3": -2.9, "q5": 0.6}), "tool")
    for ask in (robot.ik, robot.ik_all):
        ask(X, "tool")
        answer = ask(X, "tool")  # by the bound form, which the first call has made
        back = pickle.loads(pickle.dumps(answer))
        assert (
            np.array_equal(back.q, answer.q)
            and str(back) == str(answer)
            and back.status == answer.status
        )


# ------------------------------------------------------------------ threads, forks, interrupts


def test_eight_threads_give_what_one_gives():
    robot = kempe.load("puma560")
    X = robot.fk(robot.random(1, 3000), "tool")
    expected = robot.ik(X, "tool", budget=kempe.Budget(threads=1)).q
    found: list[np.ndarray] = []

    def work(count: int) -> None:
        found.append(robot.ik(X, "tool", budget=kempe.Budget(threads=count)).q)

    threads = [threading.Thread(target=work, args=(1 + k % 2,)) for k in range(8)]
    for t in threads:
        t.start()
    for t in threads:
        t.join()
    assert len(found) == 8 and all(np.array_equal(f, expected) for f in found)


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system does not fork")
def test_a_fork_while_other_threads_work():
    code = """
import os, threading, numpy as np, kempe
robot = kempe.load("puma560"); q = robot.random(1, 60000); X = robot.fk(q, "tool", threads=2)
busy = threading.Thread(target=lambda: [robot.fk(q, "tool", threads=2) for _ in range(50)]); busy.start()
for _ in range(5):
    child = os.fork()
    if child == 0:
        os._exit(0 if np.array_equal(robot.fk(q, "tool", threads=2), X) else 1)
    assert os.waitpid(child, 0)[1] == 0
busy.join(); print("done")
"""
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code], capture_output=True, text=True, timeout=120
    )
    assert done.stdout.strip() == "done", done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("threads", some([1, 2], 3))
def test_an_interrupt_ends_a_long_call(threads):
    """It comes in the second piece of a call of the slowest kernel; the process says how far it
    was.
    """
    code = f"""
import signal, numpy as np, kempe
from kempe.kernels.compiled import elimination_ik
robot = kempe.load("jaco2"); tip = robot.frame_names[-1]
X = np.tile(robot.fk(robot.random(1, 1000), tip), (100, 1, 1))
robot.ik_all(X[:10], tip)
done, kernel = [], elimination_ik.find_general_solutions
def counted(*arguments):
    if len(done) == 1:
        signal.raise_signal(signal.SIGINT)
    kernel(*arguments); done.append(len(arguments[2]))
elimination_ik.find_general_solutions = counted
signal.signal(signal.SIGINT, signal.default_int_handler)  # a process in the background may begin without
try:
    robot.ik_all(X, tip, budget=kempe.Budget(threads={threads}))
except KeyboardInterrupt:
    print(sum(done), len(X))
"""
    done, count = map(int, printed(code).split())
    assert 0 < done < count / 2


# ------------------------------------------------------------------ guarded memory

BEYOND = """
import numpy as np
from kempe.kernels import compiled
from kempe.kernels.forward.table_layout import HEADER, N_OUT, N_ROWS, NQ, NV, Q_INDEX, ROW_FLOATS, ROW_INTS, fuse_table
ints, floats = np.zeros(HEADER + ROW_INTS + 2, dtype=np.int64), np.zeros(ROW_FLOATS + 12)
ints[[N_ROWS, N_OUT, NQ, NV]] = 1
ints[HEADER : HEADER + 4] = 0, -1, {index}, 0
print(compiled.bound.compute_pose(fuse_table(ints, floats), np.zeros(1), np.empty((4, 4))))
"""
"""A joint whose coordinate is entry `index` of a configuration with one entry."""


@pytest.mark.slow
@native
@pytest.mark.skipif(sys.platform == "win32", reason="there are no guards on Windows")
def test_guards_end_a_process_that_reads_out_of_bounds():
    for guard, index in (("after", 1), ("before", -1)):
        assert printed(BEYOND.format(index=0), KEMPE_GUARD=guard) == "0"
        assert run(BEYOND.format(index=index), KEMPE_GUARD=guard).returncode == -signal.SIGSEGV
    assert (
        "KEMPE_GUARD is 'on'; allowed: 'after', 'before'"
        in run(BEYOND.format(index=0), KEMPE_GUARD="on").stderr
    )


TOO_SMALL = """
import numpy as np, kempe
from kempe.kernels.constraints import loop_layout as L
from kempe.model.packed_loops import find_explicit_joints, get_packed_loops
system = kempe.load("four_bar")
loops = get_packed_loops(system, find_explicit_joints(system))
plan, q, pins = loops.plan.copy(), system.mid[None].copy(), np.zeros((1, 0))
plan[L.{size}] -= {less}
from kempe.kernels.compiled import closure_batch, loop_closing
if "{size}" == "BLOCKS":
    out, J = np.empty((1, plan[L.N_ROWS])), np.empty((1, plan[L.N_ROWS], system.nv))
    closure_batch.evaluate_equations(loops.ints, loops.floats, plan, loops.weights, pins, q, True, out, J)
else:
    to, residual, info = np.empty((1, system.nq)), np.empty(1), np.empty((1, 3), dtype=np.int64)
    loop_closing.assemble_loops(loops.ints, loops.floats, plan, loops.weights, q, pins, 0, 3, 50, 1e-9, 0, 0, 0,
                                False, 0, to, residual, info)
print("done")
"""
"""A kernel whose plan says that its scratch is smaller than what it writes there."""


@pytest.mark.slow
@native
@pytest.mark.skipif(sys.platform == "win32", reason="there are no guards on Windows")
@pytest.mark.parametrize("size, less", [("BLOCKS", 1), ("ENVELOPE", 9)])
def test_guards_end_a_process_whose_scratch_is_too_small(size, less):
    """By one entry; of the block that begins at a whole register, by one more than what it may pass
    over.
    """
    assert printed(TOO_SMALL.format(size=size, less=0), KEMPE_GUARD="after") == "done"
    assert (
        run(TOO_SMALL.format(size=size, less=less), KEMPE_GUARD="after").returncode
        == -signal.SIGSEGV
    )


GUARDED_CURVES = """
import kempe
m = kempe.Mechanism("RUSR")
crank, rod, rocker = map(m.body, ("crank", "rod", "rocker"))
m.revolute("A", m.ground, crank)
m.revolute("D", m.ground, rocker, at=(2, 0, 0.5), rpy=(0.5, 1.2, 0))
m.universal("B", crank, rod, at=(0.5, 0, 0))
m.spherical("C", rod, rocker, at=(2, 0, 0), child_at=(1, 0, 0), cut=True)
panda = kempe.load("panda")
sweep = panda.inverse.sweep(panda.fk(panda.q("ready"), "panda_hand_tcp"), "panda_hand_tcp", n=9)
print(kempe.load("four_bar").trace("A").closed, m.build().trace("D", {"A": 0.3}).closed, bool(sweep))
"""


@pytest.mark.slow
@native
@pytest.mark.skipif(sys.platform == "win32", reason="there are no guards on Windows")
@pytest.mark.parametrize("guard", ["after", "before"])
def test_steps_of_curves_stay_in_their_memory(guard):
    assert printed(GUARDED_CURVES, KEMPE_GUARD=guard) == "True True True"


UNSET = """
import hashlib
import kempe
import numpy as np
rng = np.random.default_rng(0)
m = kempe.Mechanism("six joints")
last = m.ground
for k in range(6):
    body = m.body(f"b{k}")
    m.revolute(f"j{k}", last, body, axis=rng.normal(size=3), at=rng.uniform(-0.5, 0.5, 3), limits=(-2, 2))
    last = body
m.frame("tip", last, at=(0.1, 0.2, 0.3))
s = m.build()
found = hashlib.sha256()
for q in s.random(rng, 60):
    q = np.where(rng.random(6) < 0.3, 2.0, q)
    for kept in (False, True):
        for speed in (None, 0.1):
            for wanted in (rng.normal(size=6), s.fk(s.random(rng), "tip")):
                found.update(s.ik_step(q, wanted, "tip", 0.01, velocity_limits=speed, keep_direction=kept).velocity)
targets = s.fk(np.linspace(0.1, 0.7, 90)[:, None] * np.ones(6), "tip")
found.update(s.ik_path(targets, "tip", 0.1 * np.ones(6)).q)
loop = kempe.load("four_bar")
found.update(loop.trace("A").q)
found.update(loop.drive({"A": np.linspace(0.0, 1.0, 90)}).q)
print(found.hexdigest())
"""


@pytest.mark.slow
@native
@pytest.mark.skipif(sys.platform == "win32", reason="there are no guards on Windows")
def test_no_answer_depends_on_what_scratch_held_before():
    """In guarded memory scratch begins as no numbers."""
    plain = printed(UNSET)
    assert len(plain) == 64
    assert printed(UNSET, KEMPE_GUARD="after") == printed(UNSET, KEMPE_GUARD="before") == plain
