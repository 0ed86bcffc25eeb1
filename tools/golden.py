"""Record what every verb answers for a fixed set of systems, and compare later answers with the
record.

    python tools/golden.py compare                   # with tests/golden.json.xz, bit for bit
    python tools/golden.py compare --rtol 1e-6       # numbers within a tolerance, numbers in sentences left out
    python tools/golden.py record                    # write tests/golden.json.xz anew
    python tools/golden.py compare --systems puma560,jansen --verbs ik,trace

The systems are the shipped models and twenty robots of the package example-robot-data; the inputs
are drawn by a seed made of the names of the system and the verb. Of an array the record holds a
digest and three weighted sums, so that it stays small and a difference can still be measured.
"""

from __future__ import annotations

import argparse
import base64
import hashlib
import json
import lzma
import math
import re
import sys
import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

import kempe
from kempe import Budget, KempeError, library

ROOT = Path(__file__).resolve().parents[1]
RECORD = ROOT / "tests" / "golden.json.xz"
ROBOTS = sorted(
    Path(sys.prefix).glob("lib/python*/site-packages/cmeel.prefix/share/example-robot-data/robots")
)
FILES = """
    a1_description/urdf/a1.urdf allegro_hand_description/urdf/allegro_left_hand.urdf
    anymal_b_simple_description/robots/anymal-kinova.urdf asr_twodof_description/urdf/TwoDofs.urdf
    baxter_description/urdf/baxter.urdf bolt_description/robots/bolt.urdf
    borinot_description/urdf/borinot_flying_arm_2.urdf
    double_pendulum_description/urdf/double_pendulum_continuous.urdf finger_edu_description/robots/finger_edu.urdf
    g1_description/urdf/g1_29dof_rev_1_0.urdf hyq_description/robots/hyq_no_sensors.urdf
    kinova_description/robots/kinova.urdf panda_description/urdf/panda.urdf pr2_description/urdf/pr2.urdf
    solo_description/robots/solo12.urdf so_arm_description/urdf/so100.urdf talos_data/robots/talos_reduced.urdf
    tiago_description/robots/tiago.urdf ur_description/urdf/ur10_robot.urdf z1_description/urdf/z1.urdf
""".split()
INPUTS = 20
FEW = 3
"""Inputs of verbs that take long."""

Numbers = dict[str, Any]
Rng = np.random.Generator


# ----------------------------------------------------------------------------------------------
# systems and inputs


def names() -> list[str]:
    """The names of all systems: shipped models, and files of robots by their path."""
    return [*library.list_models(), *FILES]


def load(name: str) -> kempe.System:
    """The system of a name."""
    return kempe.load(ROBOTS[0] / name if name.endswith(".urdf") else name)


def seed(*words: str) -> Rng:
    """Random numbers that depend on these words only."""
    return np.random.default_rng(
        int.from_bytes(hashlib.sha256(" ".join(words).encode()).digest()[:8], "big")
    )


def has_loops(system: kempe.System) -> bool:
    """Whether constraints hold between coordinates of the system."""
    return bool(system.loops.constraints())


def frame_of(system: kempe.System) -> str:
    """A frame that many joints move: the last one that is declared."""
    return system.frame_names[-1]


def configurations(system: kempe.System, rng: Rng, count: int) -> np.ndarray:
    """Configurations (count, nq) inside the limits; loops are open."""
    return system.random(rng, count)


def closed(system: kempe.System, rng: Rng, count: int) -> Iterator[np.ndarray]:
    """Configurations of the assemblies found from `count` random starts; of a tree the starts
    themselves.
    """
    for start in configurations(system, rng, count):
        yield (
            start
            if not has_loops(system)
            else system.assemble(start=start, budget=Budget(starts=4)).q
        )


# ----------------------------------------------------------------------------------------------
# verbs


def answer(found: Any, *fields: str) -> Numbers:
    """Named numbers of an answer, and its sentence."""
    return {name: getattr(found, name) for name in fields} | {"status": str(found.status)}


def forward(system: kempe.System, rng: Rng) -> Iterator[Numbers]:
    """Poses of all bodies, and the Jacobian of a frame."""
    for q in configurations(system, rng, INPUTS):
        yield {"poses": system.fk(q), "jacobian": system.jacobian(q, frame_of(system))}


def inverse(system: kempe.System, rng: Rng) -> Iterator[Numbers]:
    """Answers of `ik` for poses that are reached, places, and poses twice as far away."""
    frame = frame_of(system)
    for k, q in enumerate(closed(system, rng, FEW if has_loops(system) else INPUTS)):
        X = system.fk(q, frame)
        if k % 4 == 3:
            X[:3, 3] *= 2.0
        task = "position" if k % 4 == 2 else None
        yield answer(system.ik(X, frame, task=task, budget=Budget(starts=8)), "q", "success")


def inverse_of_tasks(system: kempe.System, rng: Rng) -> Iterator[Numbers]:
    """Answers of `ik` for a place and a soft posture."""
    frame = frame_of(system)
    for q in closed(system, rng, FEW):
        tasks = [
            kempe.tasks.Position(frame, system.fk(q, frame)[:3, 3]),
            kempe.tasks.Posture({}).soft(weight=0.1),
        ]
        yield answer(system.ik(tasks, start=system.mid, budget=Budget(starts=4)), "q", "success")


def all_solutions(system: kempe.System, rng: Rng) -> Iterator[Numbers]:
    """Answers of `ik_all`."""
    frame = frame_of(system)
    for q in closed(system, rng, FEW if has_loops(system) else INPUTS):
        found = system.ik_all(system.fk(q, frame), frame)
        yield answer(found, "q", "complete", "inside")


def path(system: kempe.System, rng: Rng) -> Iterator[Numbers]:
    """Answers of `ik_path` along a straight line between two places that are reached."""
    frame = frame_of(system)
    for q in closed(system, rng, FEW):
        X = np.repeat(system.fk(q, frame)[None], 10, axis=0)
        X[:, :3, 3] += np.linspace(0.0, 0.05, 10)[:, None] * np.array([1.0, 0.0, 0.0])
        found = system.ik_path(X, frame, q)
        yield answer(found, "q", "success")


def step(system: kempe.System, rng: Rng) -> Iterator[Numbers]:
    """Answers of `ik_step` for twists and poses."""
    frame = frame_of(system)
    for k, q in enumerate(closed(system, rng, INPUTS)):
        wanted = rng.normal(size=6) if k % 2 else system.fk(system.mid, frame)
        yield answer(system.ik_step(q, wanted, frame, 0.01), "velocity")


def assemble(system: kempe.System, rng: Rng) -> Iterator[Numbers]:
    """Answers of `assemble` from random starts."""
    for start in configurations(system, rng, INPUTS):
        yield answer(system.assemble(start=start, budget=Budget(starts=8)), "q", "success")


def modes(system: kempe.System, rng: Rng) -> Iterator[Numbers]:
    """Answers of `assembly_modes` with the independent coordinates known."""
    for q in closed(system, rng, FEW):
        chart = system.independent(q)
        values = system.q_dict(q)
        known = {name: values[name] for name in chart.independent if name in values}
        found = system.assembly_modes(known, budget=Budget(starts=32))
        yield answer(found, "q", "complete", "inside")


def mobility(system: kempe.System, rng: Rng) -> Iterator[Numbers]:
    """Answers of `mobility` and `classify`."""
    found = system.mobility()
    yield answer(found, "dof", "gruebler", "rank_dof", "certain", "singular")
    for q in closed(system, rng, FEW):
        found = system.mobility(q)
        yield answer(found, "dof", "gruebler", "rank_dof", "certain", "singular")
    yield answer(system.classify(), "position_dof", "velocity_dof", "reachable_dimension")


def trace(system: kempe.System, rng: Rng) -> Iterator[Numbers]:
    """The answer of `trace`, by its length and where it is singular."""
    found = system.trace()
    yield answer(found, "length", "closed") | {
        "ends": found.q[[0, -1]],
        "singular": len(found.singular_points),
    }


def drive(system: kempe.System, rng: Rng) -> Iterator[Numbers]:
    """The answer of `drive` of the first coordinate of a closed system."""
    q = next(closed(system, rng, 1))
    values = system.q_dict(q)
    for name in [n for n in system.independent(q).independent if n in values][:1]:
        inputs = {name: values[name] + np.linspace(0.0, 0.1, 6)}
        yield answer(system.drive(inputs, start=q), "q", "success")


def spaces(system: kempe.System, rng: Rng) -> Iterator[Numbers]:
    """Dimension, samples, distances and differences of the configuration space, and the task space
    of a frame.
    """
    S = system.configuration_space
    yield answer(S, "dimension", "ambient_dimension")
    q = S.sample(4, rng)
    yield {
        "sample": q,
        "distance": S.distance(q[:2], q[2:]),
        "difference": S.difference(q[:2], q[2:]),
    }
    yield answer(system.task_space(frame_of(system)), "rank", "generic_rank", "redundancy")


def workspace(system: kempe.System, rng: Rng) -> Iterator[Numbers]:
    """The measure of a small map of a workspace."""
    if not has_loops(system):
        found = system.workspace(frame_of(system), n=2e4, cells=16)
        yield {"bounds": found.bounds, "measure": found.measure, "status": str(found.status)}


def singularities(system: kempe.System, rng: Rng) -> Iterator[Numbers]:
    """The kinds of singular configurations of a frame."""
    found = system.singularities(
        frame_of(system) if not has_loops(system) else None, budget=Budget(starts=8)
    )
    yield {"sets": len(found.sets), "status": str(found.status)}


def formulas(system: kempe.System, rng: Rng) -> Iterator[Numbers]:
    """The forward model in symbols, and the plan of the inverse model."""
    frame = frame_of(system)
    yield {"fk": str(system.symbolic.fk(frame))}
    yield {"plan": str(system.inverse.plan(frame))}


VERBS: dict[str, Callable[[kempe.System, Rng], Iterator[Numbers]]] = {
    "fk": forward,
    "ik": inverse,
    "ik of tasks": inverse_of_tasks,
    "ik_all": all_solutions,
    "ik_path": path,
    "ik_step": step,
    "assemble": assemble,
    "assembly_modes": modes,
    "mobility": mobility,
    "trace": trace,
    "drive": drive,
    "spaces": spaces,
    "workspace": workspace,
    "singularities": singularities,
    "formulas": formulas,
}

LEFT_OUT = {("row_of_four_bars", "spaces"), ("tiago_description/robots/tiago.urdf", "ik of tasks")}
"""Pairs of a system and a verb that take minutes."""


# ---------------------------------------------------------------------------------------------- the
# record


def sums(array: np.ndarray) -> list[float]:
    """Three weighted sums of an array and the number of its entries that are not finite."""
    flat = np.nan_to_num(array.ravel(), nan=0.0, posinf=0.0, neginf=0.0)
    k = np.arange(1, flat.size + 1)
    weights = [np.cos(k), np.sin(k * math.sqrt(2.0)), np.cos(k * math.sqrt(3.0))]
    return [*(float(w @ flat) for w in weights), float(np.sum(~np.isfinite(array)))]


def entry(value: Any) -> list[Any]:
    """What is stored of one value: [shape, digest, sums] of an array, [text] of a sentence."""
    if value is None or isinstance(value, str):
        return [value]
    array = np.ascontiguousarray(value, dtype=np.float64)
    digest = hashlib.sha256(array.tobytes()).digest()[:6]
    numbers = array.ravel() if array.size <= 3 else np.array(sums(array))
    return [
        list(array.shape),
        base64.b64encode(digest).decode(),
        base64.b64encode(numbers.tobytes()).decode(),
    ]


def record(name: str, verbs: Iterable[str]) -> dict[str, list[dict[str, list[Any]]]]:
    """What a system answers to these verbs: one dictionary of entries for each answer."""
    found: dict[str, list[dict[str, list[Any]]]] = {}
    system = load(name)
    for verb in verbs:
        if (name, verb) in LEFT_OUT:
            continue
        rows = found[verb] = []
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                for numbers in VERBS[verb](system, seed(name, verb)):
                    rows.append({key: entry(value) for key, value in numbers.items()})
            except KempeError as error:
                rows.append({"error": [f"{type(error).__name__}: {error}"]})
    return found


NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")


def difference(was: list[Any], now: list[Any], rtol: float | None) -> str:
    """In words what differs between two entries; empty where nothing does."""
    if was == now:
        return ""
    if len(was) == 1 or len(now) == 1:
        if rtol is not None and len(was) == len(now) == 1 and None not in (was[0], now[0]):
            if NUMBER.sub("#", was[0]) == NUMBER.sub("#", now[0]):
                return ""
        return f"{was[0]!r} became {now[0]!r}"
    if was[0] != now[0]:
        return f"shape {was[0]} became {now[0]}"
    before, after = (np.frombuffer(base64.b64decode(x[2])) for x in (was, now))
    if rtol is not None and np.allclose(before, after, rtol=rtol, atol=rtol, equal_nan=True):
        return ""
    with np.errstate(invalid="ignore"):
        return f"shape {was[0]}, sums {before.tolist()} became {after.tolist()}"


def differences(name: str, rtol: float | None, verbs: Iterable[str] = tuple(VERBS)) -> list[str]:
    """In words what a system answers otherwise than in the record."""
    was = stored()[name]
    now = record(name, verbs)
    found: list[str] = []
    for verb, rows in now.items():
        before = was.get(verb, [])
        if len(before) != len(rows):
            found.append(f"{name}, {verb}: {len(before)} answers became {len(rows)}: {rows[-1]}")
        for k, (a, b) in enumerate(zip(before, rows, strict=False)):
            for key in sorted(a.keys() | b.keys()):
                if words := difference(a.get(key, [None]), b.get(key, [None]), rtol):
                    found.append(f"{name}, {verb}, {key} of answer {k}: {words}")
    return found


def stored() -> dict[str, Any]:
    """The record in the repository."""
    return json.loads(lzma.decompress(RECORD.read_bytes()))


def main() -> int:
    """Record or compare, and print a line for each difference."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("action", choices=["record", "compare"])
    parser.add_argument(
        "--rtol", type=float, help="relative and absolute tolerance; without it bit for bit"
    )
    parser.add_argument("--systems", type=lambda text: text.split(","), default=names())
    parser.add_argument("--verbs", type=lambda text: text.split(","), default=list(VERBS))
    parser.add_argument("--processes", type=int, default=2)
    given = parser.parse_args()
    start = time.perf_counter()
    with ProcessPoolExecutor(given.processes) as pool:
        if given.action == "record":
            found = stored() if RECORD.exists() else {}
            for name, rows in zip(
                given.systems,
                pool.map(record, given.systems, [given.verbs] * len(given.systems)),
                strict=True,
            ):
                found[name] = found.get(name, {}) | rows
                print(f"{name}: {time.perf_counter() - start:.0f} s", flush=True)
            RECORD.write_bytes(
                lzma.compress(json.dumps(found, separators=(",", ":")).encode(), preset=9)
            )
            print(f"{RECORD.name}: {RECORD.stat().st_size / 1e6:.2f} MB")
            return 0
        arguments = (
            given.systems,
            [given.rtol] * len(given.systems),
            [given.verbs] * len(given.systems),
        )
        lines = [line for found in pool.map(differences, *arguments) for line in found]
    print("\n".join(lines) or "no differences", f"({time.perf_counter() - start:.0f} s)")
    return int(bool(lines))


if __name__ == "__main__":
    sys.exit(main())
