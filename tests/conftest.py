"""Settings of all tests: deterministic property tests without deadlines, and the seed of the hunts."""

from __future__ import annotations

import contextlib
import gc
import itertools
import os
import types
from collections.abc import Callable, Iterator

from kempe import arguments

os.environ.setdefault("KEMPE_QUIET", "1")
# read when NumPy is loaded: the suite runs a process for each core
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import hunts
import numpy as np
import pytest
from hypothesis import HealthCheck, settings

FAR = 1e6
"""Seconds that are added to the usual time limits."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Options of the hunts: `--hunt-seed 7 --hunt-times 100` runs them on other cases, and on more
    of them.
    """
    parser.addoption(
        "--hunt-seed", type=int, default=20261122, help="seed of the hunts for counter-examples"
    )
    parser.addoption(
        "--hunt-times",
        type=float,
        help="factor on the number of their cases (slow: 1, others: 0.25)",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Properties take the factor that hunts take; modules of tests read it when they are imported.

    While tests are collected nothing is garbage, and there are so many objects that looking for it
    takes most of the time: the collector begins with the first test, and leaves alone what was
    there before.
    """
    gc.disable()
    hunts.TIMES = config.getoption("--hunt-times") or hunts.QUICK
    settings.register_profile(
        "kempe",
        derandomize=True,
        deadline=None,
        max_examples=hunts.examples(40),
        database=None,
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
    )
    settings.load_profile("kempe")
    # Else cases have constants from the modules imported so far, and depend on the order of tests;
    # earlier versions do not look for them.
    with contextlib.suppress(ImportError):
        from hypothesis.internal.conjecture import providers

        if hasattr(providers, "_get_local_constants"):
            providers._get_local_constants = providers.Constants


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Hunts and properties have the mark `hunt`. By default warnings from inside Kempe are errors."""
    for item in items:
        if "hunt" in getattr(item, "fixturenames", ()) or getattr(
            getattr(item, "obj", None), "is_hypothesis_test", False
        ):
            item.add_marker(pytest.mark.hunt)
        if item.get_closest_marker("slow") is None and item.get_closest_marker("rest") is None:
            item.add_marker(pytest.mark.filterwarnings("error:::kempe[.]"))


def pytest_collection_finish() -> None:
    """What exists now stays until the end. The collector looks for garbage seldom: at its usual
    pace, that of a program of a few megabytes, it takes a tenth of the time.
    """
    gc.freeze()
    gc.set_threshold(100_000, 20, 10)
    gc.enable()


def pytest_sessionfinish() -> None:
    """The process ends: no garbage is looked for."""
    gc.freeze()


def pytest_report_header(config: pytest.Config) -> str:
    """The line that tells how to run the same hunts again."""
    return f"hunts: --hunt-seed {config.getoption('--hunt-seed')} --hunt-times {hunts.TIMES:g}"


@pytest.fixture
def hunt(request: pytest.FixtureRequest) -> hunts.Hunt:
    """The cases of a hunt: the same on every run with the same options, others for each test."""
    slow = request.node.get_closest_marker("slow") is not None
    times = request.config.getoption("--hunt-times") or (1.0 if slow else hunts.QUICK)
    return hunts.Hunt(request.config.getoption("--hunt-seed"), times, request.node.name)


@pytest.fixture(scope="session", autouse=True)
def usual_time_limits_are_far() -> Iterator[None]:
    """Limits that are for people, of half a minute and more, never end a test: it may run on a busy
    machine.
    """
    from kempe.inverse import numeric
    from kempe.numerics import clock

    def far(limit: float | None) -> float:
        return arguments.compute_deadline(limit) + (
            FAR if limit is not None and limit >= clock.SHORT else 0.0
        )

    with pytest.MonkeyPatch.context() as patch:
        for module in (clock, numeric):
            patch.setattr(module, "compute_deadline", far)
        yield


@pytest.fixture(scope="module")
def solved_as_marked() -> Iterator[None]:
    """Solvers close loops where they are marked `cut`: for tests of how each type of joint closes
    one.
    """
    from kempe.assemble import bound
    from kempe.equations import closure_rows, packed_tasks

    with pytest.MonkeyPatch.context() as patch:
        for module in (bound, closure_rows, packed_tasks):
            patch.setattr(module, "remove_cut_marks", lambda system: system)
        yield


@pytest.fixture
def looks(monkeypatch: pytest.MonkeyPatch) -> Callable[[int], itertools.count[int]]:
    """A clock whose time is up at look number n, counted from 0: ``looks(n)``, which gives what
    counts them.
    """
    from kempe.inverse import multi_start
    from kempe.inverse.closed_forms import problem as chain_problem
    from kempe.numerics import clock

    def at(n: int) -> itertools.count[int]:
        count = itertools.count()
        fake = types.SimpleNamespace(monotonic=lambda: np.inf if next(count) >= n else -np.inf)
        for module in (clock, multi_start, chain_problem):
            monkeypatch.setattr(module, "time", fake)
        return count

    return at
