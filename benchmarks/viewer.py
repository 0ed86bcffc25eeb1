"""Server-side time of the viewer: from an event to the last message handed to viser, without a
browser.

``python benchmarks/viewer.py`` prints medians and 90th percentiles in milliseconds: of a slider of
a humanoid (Talos of example-robot-data where that is installed), of a target of a UR5 with its
other solutions as ghosts, of loops, and of dimensions of linkages.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

import kempe
from kempe.views.viewer.live import Page, Viewer
from kempe.views.viewer.session import Session

EVENTS = 200
DATA = "lib/python*/site-packages/cmeel.prefix/share/example-robot-data/robots/talos_data/robots/talos_reduced.urdf"


def page_of(system: kempe.System, q: object = None) -> Page:
    """A page whose messages go to all clients: there are none."""
    session = Session(system, q)
    viewer = Viewer(session, True, 0)
    page = Page(viewer, viewer.server, session, viewer.drawn)
    viewer.pages[0] = page
    return page


def timed(page: Page, event: Callable[[int], object]) -> tuple[float, float]:
    """Median and 90th percentile [ms] of events that are answered and shown."""
    spent = []
    for k in range(EVENTS):
        start = time.perf_counter()
        event(k)
        page.viewer.update_pages(page)
        spent.append(1e3 * (time.perf_counter() - start))
    page.viewer.close()
    return float(np.median(spent)), float(np.percentile(spent, 90))


def slider(page: Page, number: int) -> Callable[[int], object]:
    """Events of a slider that goes to and fro in a tenth of its range."""
    s = page.session.sliders[number]
    middle = 0.5 * (s.low + s.high) if abs(s.value) > 1e-9 or s.low > 0 or s.high < 0 else s.value
    return lambda k: page.session.set_coordinate(
        s.name, middle + 0.05 * (s.high - s.low) * np.sin(0.1 * k)
    )


def dimension(page: Page, name: str) -> Callable[[int], object]:
    """Events of a parameter that goes to and fro by 5 % of its value."""
    value = page.session.system.structure.parameters[name]
    return lambda k: page.session.set_dimension(name, value * (1.0 + 0.05 * np.sin(0.1 * k)))


def target(page: Page) -> Callable[[int], object]:
    """Events of a target that goes round a circle of 2 cm, with the other solutions found anew."""
    X = page.session.pose.copy()

    def event(k: int) -> None:
        Y = X.copy()
        Y[:2, 3] += 0.02 * np.array([np.cos(0.1 * k) - 1.0, np.sin(0.1 * k)])
        page.session.reach_pose(Y)
        page.session.find_other_configurations()

    return event


def main() -> None:
    """Print the table."""
    rows = []
    for file in sorted(Path(sys.prefix).glob(DATA)):
        page = page_of(kempe.load(file, package_dirs=[file.parents[4]]))
        rows.append(
            (
                f"Talos, {len(page.session.sliders)} sliders, {len(page.nodes.drawn.shapes)} "
                "meshes: a slider",
                *timed(page, slider(page, 5)),
            )
        )
    page = page_of(kempe.load("ur5"), [0.3, -1.2, 1.5, -0.6, -1.4, 0.2])
    page.session.find_other_configurations()
    rows.append(
        (f"UR5, {len(page.session.solutions)} ghosts: a target", *timed(page, target(page)))
    )
    for name in ("four_bar", "delta_uu", "stewart_sps"):
        page = page_of(kempe.load(name))
        rows.append((f"{name}: a slider", *timed(page, slider(page, 0))))
    for name, parameter in (("four_bar", "b"), ("watt_six_bar", "b"), ("jansen", "k")):
        page = page_of(kempe.load(name))
        rows.append((f"{name}: a dimension", *timed(page, dimension(page, parameter))))
    print("| | median, ms | 90 % of events, ms |\n|---|--:|--:|")
    for name, median, high in rows:
        print(f"| {name} | {median:.2f} | {high:.2f} |")


if __name__ == "__main__":
    main()
