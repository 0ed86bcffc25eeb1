"""Distances of an arm with spheres; two arms that keep apart: targets near obstacles, and hands
that are pushed together.
"""

from __future__ import annotations

import os
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

import kempe
from kempe import Budget, tasks
from kempe.constraints import Clearance
from kempe.description.urdf_writer import write_urdf
from kempe.spatial import Array
from kempe_bench import peers
from kempe_bench.bench import Bench
from kempe_bench.timing import Case, Grid, Row, Table, measure

APART = 0.02
"""Metres that all bodies keep."""
NEAR = 0.1
"""Targets are of configurations in which something is at most that near."""
TARGETS = 100
CYCLE = 0.002
"""Seconds of one step of the stream."""
STEPS = 1500
SPEED = 3.0
"""Largest speed of every joint, rad/s."""
PATIENCE = 300
"""Steps of 0.05 s that a differential solver has for one target."""
LONG = 0.05
REACHED = 1e-4
"""Error of the hands, in metres, that counts as reached."""
SIDES = ("left", "right")
HANDS = tuple(f"{side}_hand" for side in SIDES)


BATCH = 100_000
"""Configurations whose distances are measured in one call."""
LOOP = 50
"""Configurations that a loop in Python measures."""
SPHERES = (4, 4, 4, 4, 4, 4, 3, 3)
"""Spheres on each link of the Panda."""


@contextmanager
def use_one_processor() -> Iterator[None]:
    """Keep this process on one processor, where the system can."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(before)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


def make_spheres() -> kempe.Mechanism:
    """A Panda with 30 spheres on its links."""
    m = kempe.read("panda")
    rng = np.random.default_rng(0)
    for link, count in zip(list(m.bodies), SPHERES, strict=True):
        for place in rng.uniform(-0.08, 0.08, (count, 3)):
            m.shape(link, "sphere", radius=0.06, at=tuple(place))
    return m


def make_coal_loop(system: kempe.System) -> Callable[[Array], Array]:
    """Return a function that measures configurations by coal, pair by pair, as one would write it."""
    coal = peers.module("coal")
    bodies = system.mechanism.bodies
    names = [name for name in bodies if bodies[name].shapes]
    of = {name: [(coal.Sphere(s.geometry.radius), s.X_BS.evaluate_pose({})[:3, 3])
                 for s in bodies[name].shapes] for name in names}  # fmt: skip
    pairs = [(a, b, x, y) for a, b in system.geometry.pairs for x in of[a] for y in of[b]]
    request = coal.DistanceRequest()
    result = coal.DistanceResult()

    def place(X: Array, at: Array) -> Any:
        return coal.Transform3s(X[:3, :3], X[:3, :3] @ at + X[:3, 3])

    def measure_each(q: Array) -> Array:
        out = np.empty(len(q))
        for k, X in enumerate(system.fk(q, names)):
            at = dict(zip(names, X, strict=True))
            placed = {id(s): place(at[name], s[1]) for name in names for s in of[name]}
            best = np.inf
            for _, _, x, y in pairs:
                result.clear()
                d = coal.distance(x[0], placed[id(x)], y[0], placed[id(y)], request, result)
                best = min(best, d)
            out[k] = best
        return out

    return measure_each


def make_pinocchio_loop(system: kempe.System, file: Path) -> Callable[[Array], Array]:
    """Return one that measures them by Pinocchio, which calls coal for all pairs at once."""
    pin = peers.module("pinocchio")
    model = pin.buildModelFromUrdf(str(file))
    solids = pin.buildGeomFromUrdf(model, str(file), pin.GeometryType.COLLISION)
    of: dict[str, list[int]] = {}
    for k, solid in enumerate(solids.geometryObjects):
        of.setdefault(model.frames[solid.parentFrame].name, []).append(k)
    for a, b in system.geometry.pairs:
        for i in of[a]:
            for j in of[b]:
                solids.addCollisionPair(pin.CollisionPair(min(i, j), max(i, j)))
    data = model.createData()
    placed = pin.GeometryData(solids)
    order = [system.coordinate_names.index(name) for name in list(model.names)[1:]]

    def measure_each(q: Array) -> Array:
        out = np.empty(len(q))
        for k, x in enumerate(q[:, order]):
            pair = pin.computeDistances(model, data, solids, placed, x)
            out[k] = placed.distanceResults[pair].min_distance
        return out

    return measure_each


def distances(bench: Bench) -> Table:
    """The smallest distance of a Panda with 30 spheres on its links."""
    table = Table("Smallest distance of a Panda with 30 spheres, 280 pairs, one core", "us")
    with tempfile.TemporaryDirectory() as folder, use_one_processor():
        mechanism = make_spheres()
        file = Path(folder) / "spheres.urdf"
        file.write_text(write_urdf(mechanism), encoding="utf-8")
        system = mechanism.build()
        q = system.random(0, BATCH)
        names: dict[str, Any] = {"q": q, "few": q[:LOOP]}
        batch = f"{BATCH:,} configurations in one call"
        own = {**names, "of": system.geometry.clearance}
        timed = [Case("Kempe", batch, "of(q)", own, BATCH)]
        timed.append(Case("Kempe", "one configuration a call", "of(few[0])", own))
        loops = {"coal": make_coal_loop(system)}
        if "pin" in bench.versions:
            loops["Pinocchio"] = make_pinocchio_loop(system, file)
        how = {
            "coal": f"by hand: Python loop over {LOOP}, and over their pairs",
            "Pinocchio": f"computeDistances (coal): Python loop over {LOOP}",
        }
        timed += [
            Case(who, how[who], "of(few)", {**names, "of": of}, LOOP) for who, of in loops.items()
        ]
        table.rows += measure(timed, 1e6)
        known = system.geometry.clearance(names["few"])
        apart = [float(np.abs(of(names["few"]) - known).max()) for of in loops.values()]
    best = table.best("Kempe", batch)
    table.at_most(f"{BATCH:,} configurations, at most 0.2 s", best and 1e-6 * BATCH * best, 0.2)
    table.at_most("difference to coal, at most 1e-12 m", max(apart), 1e-12)
    table.remarks.append("neighbours left out; a row counts the forward model as well")
    return table


def make_cell() -> kempe.Mechanism:
    """Two arms of six turns with spheres on their links, at one table with a post."""
    m = kempe.Mechanism("two_arms")
    m.body("base")
    m.fixed("stand", m.ground, "base")
    for side, x in zip(SIDES, (-0.4, 0.4), strict=True):
        last: Any = "base"
        for k, axis in enumerate("zyyzyz"):
            link = f"{side}_{k}"
            at = (0, 0, 0.2) if k else (x, 0, 0)
            m.revolute(f"{side}_q{k}", last, m.body(link), at=at, axis=axis, limits=(-2.9, 2.9))
            m.shape(link, "sphere", radius=0.06, at=(0, 0, 0.1))
            last = link
        hand = m.body(f"{side}_hand")
        m.fixed(f"{side}_flange", last, hand, at=(0, 0, 0.2))
    m.obstacle("table", "box", size=(1.6, 1.0, 0.1), at=(0, 0, -0.1))
    m.obstacle("post", "sphere", radius=0.1, at=(0, 0.1, 0.6))
    return m


class Cell:
    """The cell as Kempe's system, and as a file for the others."""

    def __init__(self, folder: str):
        mechanism = make_cell()
        self.file = Path(folder) / "cell.urdf"
        self.file.write_text(write_urdf(mechanism), encoding="utf-8")
        self.system = mechanism.build()
        self.pairs = self.system.geometry.pairs

    def measure_distance(self, q: Array) -> Any:
        """Measure the smallest distances of the shapes."""
        return self.system.geometry.clearance(q)

    def find_hands(self, q: Array) -> Array:
        """Find the places (..., 2, 3) of the hands."""
        return self.system.fk(q, list(HANDS))[..., :3, 3]


class KempeArms:
    """`ik_step` with a `Clearance` among its tasks."""

    failures: tuple[type[Exception], ...] = ()
    """What a step raises that finds no solution."""

    def __init__(self, cell: Cell):
        self.system = cell.system
        self.q = cell.system.neutral

    def step(self, places: Array, dt: float) -> None:
        """One cycle towards two places (2, 3)."""
        wanted = [
            *(tasks.Position(h, p) for h, p in zip(HANDS, places, strict=True)),
            Clearance("self", at_least=APART),
        ]
        self.q = self.system.ik_step(self.q, wanted, dt=dt, velocity_limits=SPEED).q


class MinkArms:
    """mink: a quadratic program for each cycle by daqp, with `CollisionAvoidanceLimit`."""

    def __init__(self, cell: Cell):
        mink = peers.module("mink")
        mujoco = peers.module("mujoco")
        text = cell.file.read_text(encoding="utf-8")
        settings = '<mujoco><compiler fusestatic="false" strippath="false"/></mujoco></robot>'
        inertia = (
            '<inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'
            "</inertial></link>"
        )
        text = text.replace("</link>", inertia).replace("</robot>", settings)
        for side in SIDES:
            text = text.replace(
                f'<link name="{side}_hand"/>', f'<link name="{side}_hand">{inertia}'
            )
        model = mujoco.MjModel.from_xml_string(text)
        body = mujoco.mjtObj.mjOBJ_BODY
        joint = mujoco.mjtObj.mjOBJ_JOINT
        names = [mujoco.mj_id2name(model, joint, i) for i in range(model.njnt)]
        self.order = [names.index(name) for name in cell.system.coordinate_names]
        geoms: dict[str, list[int]] = {}
        for g in range(model.ngeom):
            geoms.setdefault(mujoco.mj_id2name(model, body, model.geom_bodyid[g]), []).append(g)
        self.configuration = mink.Configuration(model)
        self.tasks = [
            mink.FrameTask(h, "body", position_cost=1.0, orientation_cost=0.0, lm_damping=1e-3)
            for h in HANDS
        ]
        self.limits = [
            mink.ConfigurationLimit(model),
            mink.VelocityLimit(model, dict.fromkeys(names, SPEED)),
            mink.CollisionAvoidanceLimit(
                model,
                [(geoms[a], geoms[b]) for a, b in cell.pairs],
                minimum_distance_from_collisions=APART,
                collision_detection_distance=APART + NEAR,
            ),
        ]
        self.solve = mink.solve_ik
        self.failures = (mink.NoSolutionFound,)
        self.place = mink.SE3.from_translation

    @property
    def q(self) -> Array:
        """The configuration in Kempe's order."""
        return np.asarray(self.configuration.q)[self.order]

    @q.setter
    def q(self, q: Array) -> None:
        own = np.empty(len(q))
        own[self.order] = q
        self.configuration.update(own)

    def step(self, places: Array, dt: float) -> None:
        """One cycle towards two places (2, 3)."""
        for task, place in zip(self.tasks, places, strict=True):
            task.set_target(self.place(place))
        options: dict[str, Any] = {"solver": "daqp", "damping": 1e-6, "limits": self.limits}
        v = self.solve(self.configuration, self.tasks, dt, **options)
        self.configuration.integrate_inplace(v, dt)


class PinkArms:
    """pink: a quadratic program for each cycle by daqp, with `SelfCollisionBarrier`."""

    def __init__(self, cell: Cell):
        pink = peers.module("pink")
        pin = peers.module("pinocchio")
        barriers = peers.module("pink.barriers")
        model = pin.buildModelFromUrdf(str(cell.file))
        model.velocityLimit[:] = SPEED
        solids = pin.buildGeomFromUrdf(model, str(cell.file), pin.GeometryType.COLLISION)
        of: dict[str, list[int]] = {}
        for k, solid in enumerate(solids.geometryObjects):
            of.setdefault(model.frames[solid.parentFrame].name, []).append(k)
        for a, b in cell.pairs:
            for i in of[a]:
                for j in of[b]:
                    solids.addCollisionPair(pin.CollisionPair(min(i, j), max(i, j)))
        self.order = [model.names.tolist().index(n) - 1 for n in cell.system.coordinate_names]
        self.configuration = pink.Configuration(
            model, model.createData(), np.zeros(model.nq), collision_model=solids,
            collision_data=pin.GeometryData(solids),
        )  # fmt: skip
        self.tasks = [
            pink.tasks.FrameTask(h, position_cost=1.0, orientation_cost=0.0, lm_damping=1e-3)
            for h in HANDS
        ]
        self.barriers = [
            barriers.SelfCollisionBarrier(len(solids.collisionPairs), gain=20.0, d_min=APART)
        ]
        self.solve = pink.solve_ik
        self.failures = (peers.module("pink.exceptions").NoSolutionFound,)
        self.place = lambda p: pin.SE3(np.eye(3), np.asarray(p))

    @property
    def q(self) -> Array:
        """The configuration in Kempe's order."""
        return np.asarray(self.configuration.q)[self.order]

    @q.setter
    def q(self, q: Array) -> None:
        own = np.empty(len(q))
        own[self.order] = q
        self.configuration.update(own)

    def step(self, places: Array, dt: float) -> None:
        """One cycle towards two places (2, 3)."""
        for task, place in zip(self.tasks, places, strict=True):
            task.set_target(self.place(place))
        options: dict[str, Any] = {"solver": "daqp", "damping": 1e-6, "safety_break": False}
        v = self.solve(self.configuration, self.tasks, dt, barriers=self.barriers, **options)
        self.configuration.integrate_inplace(v, dt)


def find_clear_start(cell: Cell) -> Array:
    """Find the configuration of some hundreds that is furthest from touching."""
    q = cell.system.random(2, 500)
    return q[int(np.argmax(cell.measure_distance(q)))]


def list_arms(bench: Bench) -> dict[str, Any]:
    """List who takes part."""
    found: dict[str, Any] = {"Kempe": KempeArms}
    if "mink" in bench.versions:
        found["mink"] = MinkArms
    if "pin-pink" in bench.versions:
        found["pink"] = PinkArms
    return found


def push(bench: Bench) -> Grid:
    """Both hands of two arms are pushed towards the same place, cycle by cycle."""
    table = Grid(f"Two arms pushed together: {STEPS} cycles, {APART:g} m to be kept", "stream")
    with tempfile.TemporaryDirectory() as folder:
        cell = Cell(folder)
        start = find_clear_start(cell)
        for name, make in list_arms(bench).items():
            bench.say(f"  {name}")
            arms = make(cell)
            arms.q = start.copy()
            meeting = np.array([[0.3, 0.0, 0.4], [-0.3, 0.0, 0.4]])
            times = []
            way = []
            failed = 0
            for _ in range(STEPS):
                before = time.perf_counter()
                try:
                    arms.step(meeting, CYCLE)
                except arms.failures:  # the arm stands still
                    failed += 1
                times.append(time.perf_counter() - before)
                way.append(np.array(arms.q))
            d = cell.measure_distance(np.array(way))
            table.rows += [
                Row(name, "a cycle, median in us", 1e6 * statistics.median(times)),
                Row(name, "a cycle, 99 % in us", 1e6 * float(np.quantile(times, 0.99))),
                Row(name, "cycles nearer than asked", float(np.sum(d < APART - 1e-6))),
                Row(name, "nearest, mm", 1e3 * float(np.min(d))),
                Row(name, "cycles without a solution", float(failed)),
                Row(name, "hands from their place, mm", _find_miss(cell, arms.q, meeting)),
            ]
    table.remarks.append(
        f"two arms of six turns, spheres on their links; cycles of {CYCLE:g} s, joints up to "
        f"{SPEED:g} rad/s; distances are measured after each cycle"
    )
    table.at_most("cycles nearer than asked, 0", table.value("Kempe", "cycles nearer"), 0.0)
    return table


def _find_miss(cell: Cell, q: Array, places: Array) -> float:
    """Find how far the farther hand is from its place, in millimetres."""
    return 1e3 * float(np.linalg.norm(cell.find_hands(q) - places, axis=-1).max())


def reach(bench: Bench) -> Grid:
    """Places for both hands that are reachable clear of everything, with something near."""
    table = Grid(f"Two arms among obstacles: {TARGETS} reachable pairs of places", "targets")
    with tempfile.TemporaryDirectory() as folder:
        cell = Cell(folder)
        s = cell.system
        q = s.random(0, 40 * TARGETS)
        d = cell.measure_distance(q)
        places = cell.find_hands(q[(d >= APART) & (d <= NEAR)][:TARGETS])
        start = find_clear_start(cell)
        for name, found, times in _solve_each(bench, cell, places, start):
            clear = cell.measure_distance(found) >= APART - 1e-9
            there = np.linalg.norm(cell.find_hands(found) - places, axis=-1).max(axis=-1) <= REACHED
            table.rows += [
                Row(name, "reached and clear, %", 100.0 * float(np.mean(clear & there))),
                Row(name, "reached, too near, %", 100.0 * float(np.mean(there & ~clear))),
                Row(name, "median in ms", 1e3 * statistics.median(times)),
            ]
    table.remarks.append(
        f"in one of the configurations of each target the nearest bodies are {APART:g} to "
        f"{NEAR:g} m apart; Kempe `ik` from its own starts; the others by up to {PATIENCE} steps of "
        f"{LONG:g} s from one start, as they have no search"
    )
    table.at_least("reached and clear, 99 %", table.value("Kempe", "reached and clear"), 99.0)
    return table


def _solve_each(
    bench: Bench, cell: Cell, places: Array, start: Array
) -> Iterator[tuple[str, Array, list[float]]]:
    """Solve all targets by each library: its name, configurations and times."""
    for name, make in list_arms(bench).items():
        bench.say(f"  {name}")
        found = []
        times = []
        arms = make(cell)
        for pair in places:
            before = time.perf_counter()
            if name == "Kempe":
                wanted = [tasks.Position(h, p) for h, p in zip(HANDS, pair, strict=True)]
                clear = Clearance("self", at_least=APART)
                q = cell.system.ik([*wanted, clear], budget=Budget(threads=1)).q
            else:
                q = _descend(cell, arms, pair, start)
            times.append(time.perf_counter() - before)
            found.append(q)
        yield name, np.array(found), times


def _descend(cell: Cell, arms: Any, pair: Array, start: Array) -> Array:
    """Step towards a target until it is reached, or patience ends."""
    arms.q = start.copy()
    for _ in range(PATIENCE):
        try:
            arms.step(pair, LONG)
        except arms.failures:
            break
        if np.linalg.norm(cell.find_hands(arms.q) - pair, axis=-1).max() <= REACHED:
            break
    return np.array(arms.q)
