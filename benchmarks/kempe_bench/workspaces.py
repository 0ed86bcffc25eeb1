"""Maps of workspaces: samples a second, beside a plain script of numpy; two threads beside one."""

from __future__ import annotations

import math

import numpy as np

from kempe.description.urdf_writer import write_urdf
from kempe_bench import peers
from kempe_bench.bench import Bench
from kempe_bench.timing import Case, Table, measure

ARMS = {"puma560": "tool", "panda": "tool"}
SAMPLES = 20_000_000
BY_HAND = 20_000
CELLS = 256
ONE = "Kempe, one thread"
TWO = "Kempe, two threads"
NUMPY = "numpy, by hand"
TORCH = "pytorch-kinematics"


def binned(bench: Bench) -> Table:
    """Nanoseconds a sample, drawn, placed and counted in 256^3 cells."""
    import kempe
    from kempe.workspace.sampling_job import count_in_threads, make_recipe

    table = Table("Maps of workspaces: drawn, placed and counted, by samples", "ns", ratios=True)
    for name, frame in ARMS.items():
        system = kempe.load(name)
        recipe = make_recipe(system, frame, 0, CELLS, None)
        names = {"count": count_in_threads, "recipe": recipe, "check": lambda done: None}
        timed = [
            Case(
                who,
                name,
                "count(recipe, 0, n, threads, check)",
                {**names, "n": 2 * SAMPLES, "threads": threads},
                2 * SAMPLES,
            )
            for who, threads in ((ONE, 1), (TWO, 2))
        ]
        timed.append(
            Case(
                NUMPY,
                name,
                "by_hand(system, frame, n, box)",
                {
                    "by_hand": by_hand,
                    "system": system,
                    "frame": frame,
                    "n": BY_HAND,
                    "box": list(zip(recipe.grid.low, recipe.grid.high, strict=True)),
                },
                BY_HAND,
            )
        )
        if "pytorch-kinematics" in bench.versions:
            timed.append(_torch(system, frame, timed[-1].names["box"]))
        table.rows += measure(timed, 1e9)
    table.at_most(
        f"one thread, ns a sample of {next(iter(ARMS))}", table.best(ONE, "puma560"), 50.0
    )
    one = table.best(ONE, "puma560")
    two = table.best(TWO, "puma560")
    if one and two:
        table.at_least("two threads, times one", one / two, 1.8)
    table.remarks += [
        f"{CELLS}^3 cells; numpy by hand multiplies matrices of all joints, and counts by add.at",
        "pytorch-kinematics has its own forward model, and counts as numpy by hand does",
        "pycapacity answers another question: what is reached within a time, as a convex body",
    ]
    return table


def by_hand(system, frame: str, n: int, box: list[tuple[float, float]]) -> np.ndarray:
    """The same map as one would write it with numpy alone: matrices of joints, then a histogram."""
    table = system.structure.table
    rows = table.find_path(frame)
    q = np.random.default_rng(0).uniform(system.lower, system.upper, (n, system.nq))
    X = np.broadcast_to(np.eye(4), (n, 4, 4))
    for row in rows:
        angle = table.multiplier[row] * q[:, table.iq[row]] + table.offset[row]
        s = np.sin(angle)
        c = np.cos(angle)
        turn = np.zeros((n, 4, 4))
        turn[:, 0, 0], turn[:, 0, 1], turn[:, 1, 0], turn[:, 1, 1] = c, -s, s, c
        turn[:, 2, 2] = turn[:, 3, 3] = 1.0
        X = X @ table.placement[row] @ turn
    return counted((X @ table.at[frame][1])[:, :3, 3], box)


def counted(points: np.ndarray, box: list[tuple[float, float]]) -> np.ndarray:
    """How many points (n, 3) lie in each cell of a box."""
    edges = [np.linspace(low, high, CELLS + 1) for low, high in box]
    at = [np.searchsorted(e, p, side="right") - 1 for e, p in zip(edges, points.T, strict=True)]
    inside = np.logical_and.reduce([(0 <= k) & (k < CELLS) for k in at])
    flat = np.ravel_multi_index([k[inside] for k in at], (CELLS,) * 3)
    counts = np.zeros(CELLS**3, dtype=np.uint32)
    np.add.at(counts, flat, 1)
    assert math.isclose(float(counts.sum()), float(inside.sum()))
    return counts


def _torch(system, frame: str, box: list[tuple[float, float]]) -> Case:
    """The same map with the forward model of pytorch-kinematics, one thread, float32, and the same
    counting.
    """
    torch = peers.module("torch")
    kinematics = peers.module("pytorch_kinematics")
    torch.set_num_threads(1)
    chain = kinematics.build_serial_chain_from_urdf(write_urdf(system.mechanism).encode(), frame)
    names = chain.get_joint_parameter_names()
    at = [system.coordinate_names.index(name) for name in names]
    low, high = (torch.tensor(x[at], dtype=torch.float32) for x in (system.lower, system.upper))

    def run() -> np.ndarray:
        q = low + (high - low) * torch.rand(BY_HAND, len(at))
        return counted(chain.forward_kinematics(q).get_matrix()[:, :3, 3].numpy(), box)

    return Case(TORCH, system.name, "run()", {"run": run}, BY_HAND)
