"""`System`, the compiled multibody system. Its methods lead to all parts of the library.

They call the functions of later layers.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, Literal, NoReturn

import numpy as np
from numpy.typing import ArrayLike

from kempe.arguments import add_signature_options, explain_errors, quiet
from kempe.budget import Budget
from kempe.description.mechanism import extract_group
from kempe.description.parts import Frame, ReadOnlyDict
from kempe.errors import (
    MEMBERS_ELSEWHERE,
    MEMBERS_WITHIN,
    InputError,
    UnknownNameError,
    raise_missing_member,
)
from kempe.model import configurations
from kempe.model.model import FrameLike, Model, SystemType
from kempe.spatial import Array
from kempe.views.plot_options import PlotOptions

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path as FilePath

    from distributed import Client
    from matplotlib.axes import Axes
    from numpy.typing import DTypeLike

    from kempe.argument_types import (
        ConfigurationLike,
        Frames,
        HasConfigurations,
        HeldLike,
        Inputs,
        KnownValues,
        Limits,
        MotionLike,
        PoseLike,
        Preference,
        StartLike,
        TargetLike,
        TaskLike,
    )
    from kempe.assemble.answer import Assembly
    from kempe.assemble.modes import Modes
    from kempe.assemble.nearest_exact import Idealised
    from kempe.constraints.base import Constraint
    from kempe.description.mechanism import Mechanism
    from kempe.designs import Designs
    from kempe.forward.fk import Query
    from kempe.inverse.all_answer import Solutions
    from kempe.inverse.answer import Solution
    from kempe.inverse.ik_step import IkStep
    from kempe.inverse.path import IkPath
    from kempe.mobility.answer import Mobility
    from kempe.mobility.classify import Classification
    from kempe.mobility.independent import Chart
    from kempe.motion.drive import Drive
    from kempe.motion.manoeuvre import Manoeuvre
    from kempe.motion.path import Path as Motion
    from kempe.motion.simulate import Simulation
    from kempe.namespaces import BodyGeometry, Inverse, Loops, ReachStudies, Symbolic
    from kempe.spaces.configuration_space import ConfigurationSpace
    from kempe.spaces.singularities import Singularities
    from kempe.spaces.task_space import TaskSpace
    from kempe.views.viewer.live import Viewer
    from kempe.workspace.answer import Workspace

__all__ = ["FrameLike", "System"]


# ---- systems with joints taken out


@explain_errors
def open_loops(system: SystemType, joints: str | Iterable[str] | None = None) -> SystemType:
    """Return the system without these joints, by default the cut joints; see `System.open_loops`."""
    given = [joints] if isinstance(joints, str) else joints
    names = system.structure.closures if given is None else tuple(dict.fromkeys(map(str, given)))
    if not names:
        tied = system.kind.endswith(("loop", "loops"))
        said = "constraints close its loops, no joints" if tied else f"it is a {system.kind}"
        raise InputError(f"{system.name} has no loop to open: {said}")
    mechanism = system.mechanism
    for name in names:
        if name not in mechanism.joints:
            raise UnknownNameError("joint", name, tuple(mechanism.joints), system.name)
        _add_joint_frames(mechanism, name)
        gone = set(system.structure.coordinates_of_joint(name))
        del mechanism.joints[name]
        mechanism.postures = {
            k: {c: x for c, x in p.items() if c not in gone} for k, p in mechanism.postures.items()
        }
        mechanism.locks = {c: x for c, x in mechanism.locks.items() if c not in gone}
        mechanism.groups = {
            k: tuple(joint for joint in group if joint != name)
            for k, group in mechanism.groups.items()
        }
    return type(system)(mechanism)


def _add_joint_frames(mechanism: Mechanism, name: str) -> None:
    """Add frames at both ends of a joint to its moving bodies, before their other frames."""
    joint = mechanism.joints[name]
    frames = dict[str, Frame]()
    for body, X in ((joint.parent, joint.X_PF), (joint.child, joint.X_CM)):
        label = f"{name} on {body}"
        taken = label in mechanism.frames or label in mechanism.bodies
        if (
            body != mechanism.ground.name
            and not taken
            and not (mechanism.bodies[body].particle and X.steps)
        ):
            frames[label] = Frame(label, body, X)
    mechanism.frames = {**frames, **mechanism.frames}


# ---- pictures and pages


class Pictured:
    """Methods that draw a system. Base of `System`."""

    @explain_errors
    @add_signature_options(PlotOptions)
    def plot(
        self: Any,
        q: StartLike | HasConfigurations | None = None,
        *,
        path: MotionLike | None = None,
        **options: Any,
    ) -> Axes | tuple[Axes, ...]:
        """Draw the system at one or several configurations, or along a motion.

        Parameters
        ----------
        q
            Configuration (nq,), values by name, or the name of a posture; several configurations
            (k, nq); or an answer that has them, such as `Solution` or `Modes`. Several are drawn
            one over the other, with their names, or `side_by_side`. Default: the posture 'closed',
            else `mid`, with closed loops where possible; with a `path`, its configuration nearest
            to home.
        path
            Motion: configurations (n, nq), or an answer with a `q` of this shape. Curves of the
            named `frames` are drawn over it.
        **options
            Fields of `kempe.views.plot_options.PlotOptions`.

        Returns
        -------
        Axes
            Matplotlib axes, or a tuple of axes with `side_by_side`. ``.figure.savefig("name.png")``
            writes the picture.

        Raises
        ------
        InputError
            For wrong shapes or values.
        UnknownNameError
            If there is no such frame.
        UnsupportedError
            For a workspace that cannot be drawn.
        CallError
            For unknown options.
        MissingExtraError
            Without the extra [view].

        Notes
        -----
        Driven joints are marked. Loops that are open, and targets that an answer misses, are drawn
        with their distance.
        """
        from kempe.views.plots import plot

        return plot(self, q, path=path, **options)

    @explain_errors
    def animate(
        self: Any,
        path: MotionLike,
        file: str | FilePath,
        *,
        frames: FrameLike | Sequence[FrameLike] = (),
        labels: bool | str | Sequence[str] = False,
        seconds: float = 4.0,
        fps: float = 15.0,
        size: int | None = None,
    ) -> FilePath:
        """Write a motion as an animation.

        Parameters
        ----------
        path
            Answer with a motion or several configurations, or configurations (n, nq) at equal
            intervals.
        file
            File name; its ending selects the format: .gif, .mp4 or .html.
        frames
            Names of frames whose curves are drawn.
        labels
            Labels in the picture, as in `plot`.
        seconds, fps
            Duration in seconds, and pictures for each second.
        size
            Pixels of the longer side of the picture (default: 100 an inch of the drawing).

        Returns
        -------
        Path
            Path of the file.

        Raises
        ------
        InputError
            For wrong shapes and endings.
        UnsupportedError
            For .mp4 without the program ffmpeg.
        MissingExtraError
            Without the extra [view].
        """
        from kempe.views.films import animate

        return animate(
            self, path, file, frames=frames, labels=labels, seconds=seconds, fps=fps, size=size
        )

    @explain_errors
    def show(
        self: Any,
        q: StartLike | None = None,
        *,
        frame: FrameLike | None = None,
        path: MotionLike | None = None,
        share: bool = False,
        port: int | None = None,
        browser: bool = True,
        deg: bool = False,
    ) -> Viewer:
        """Show the system in the browser, where the mouse moves it.

        Parameters
        ----------
        q
            Configuration (nq,) or values by name (default: as in `plot`). Open loops are closed
            from it.
        frame
            Name of the frame that is dragged (default: the last one declared).
        path
            Motion to play: configurations (n, nq), or an answer with a `q` of this shape.
        share
            All pages show one configuration. Otherwise each page has its own.
        port
            Port of the page on this machine (default: 8080, or the next free one).
        browser
            Open the page in the browser.
        deg
            Show angles in degrees; a switch on the page changes that.

        Returns
        -------
        Viewer
            The page with its address `url`. It is served until `close`, the end of a ``with``
            block, or the end of Python.

        Raises
        ------
        InputError
            For wrong shapes, and a port that is in use.
        UnknownNameError
            If there is no such frame.
        MissingExtraError
            Without the extra [view].

        Notes
        -----
        A `UserWarning` names the meshes that are not drawn.
        """
        from kempe.views.viewer.live import show

        return show(
            self, q, frame=frame, path=path, share=share, port=port, browser=browser, deg=deg
        )

    @explain_errors
    def save_html(
        self: Any,
        file: str | FilePath,
        q: StartLike | None = None,
        *,
        path: MotionLike | None = None,
        frame: FrameLike | None = None,
        labels: bool = False,
        seconds: float = 6.0,
    ) -> None:
        """Write an HTML page with the system in space, which needs no server or network.

        The mouse turns the view. A motion has a slider and a button to play it; sliders of
        coordinates and targets need the live page of `show`.

        Parameters
        ----------
        file
            File name that ends in .html, in a folder that exists.
        q
            Configuration (nq,) or values by name (default: as in `plot`).
        path
            Motion that is played repeatedly: configurations (n, nq), or an answer with such a `q`.
        frame
            Name of the frame whose curve in the motion is drawn (default: as in `show`).
        labels
            Whether joints, bodies and frames have their names beside them.
        seconds
            Duration of the motion in seconds.

        Raises
        ------
        InputError
            For wrong shapes, another ending, or a folder that does not exist.
        UnknownNameError
            If there is no such frame.
        MissingExtraError
            Without the extra [view].

        Notes
        -----
        A `UserWarning` names the meshes that are not drawn.
        """
        from kempe.views.viewer.pages import save_html

        return save_html(self, file, q, path=path, frame=frame, labels=labels, seconds=seconds)

    @explain_errors
    def plot_tree(self: Any, ax: Axes | None = None) -> Axes:
        """Draw the spanning tree: bodies as circles by depth, joints as lines with their letters.

        Joints that close loops are dashed red lines. Letters: R revolute, P prismatic, H helical, C
        cylindrical, U universal, E planar, T translation, S spherical, F free. A product has the
        letters of its factors.

        Parameters
        ----------
        ax
            Matplotlib axes (default: new ones).

        Returns
        -------
        Axes
            The axes of the picture.
        """
        from kempe.views.overviews import plot_tree

        return plot_tree(self, ax)

    @quiet
    def _repr_html_(self: Any) -> str:
        """The system in a notebook: a picture, its freedoms, its tree."""
        from kempe.views.overviews import make_notebook_page

        return make_notebook_page(self)

    @explain_errors
    def plot_spaces(
        self: Any,
        frame: FrameLike,
        *,
        points: ArrayLike = (),
        q: StartLike | MotionLike | Sequence[MotionLike] | None = None,
        task: str | None = None,
        grid: bool = False,
        ax: Sequence[Axes] | None = None,
        resolution: int = 240,
        budget: Budget | None = None,
    ) -> tuple[Axes, Axes]:
        """Draw configuration space and task space of a system with two freedoms side by side.

        Parameters
        ----------
        frame
            Name of the frame whose places are drawn.
        points
            Places (k, 2) that the frame should reach. Their solutions are marked in both pictures;
            where there is none, the nearest place and its distance.
        q
            Configuration (nq,), drawn as a point; a line of configurations (n, nq) or an answer
            with such a `q`, drawn as a line that starts at a ring; or a list of these.
        task
            Two numbers of the frame: "xy", "xz" or "yz" (position along two ground axes in metres),
            or "direction" (azimuth and elevation of its z axis in radians).
        grid
            Draw lines on which one coordinate is constant, and their images.
        ax
            Pair of Matplotlib axes (default: new ones).
        resolution
            Number of places along each axis, 8 to 1000.
        budget
            Reads time_limit (120 s) and progress(places, all), for each of the two pictures.

        Returns
        -------
        tuple of Axes
            Axes of the configuration space and of the task space. After the time limit they show
            the finished part.

        Raises
        ------
        UnsupportedError
            For another number of freedoms, and frames whose places form a curve only.
        InputError
            For wrong shapes or values.
        UnknownNameError
            If there is no such frame.
        Interrupted
            After Ctrl-C, with the axes as its `answer`.

        Notes
        -----
        Limits are a rectangle on the left, and their image on the right. Edges of a full turn are
        dotted. Red lines are singular: the frame's velocity loses a direction. Shades count the
        configurations within limits that reach a place.

        With closed loops the left axes are the two actuated coordinates, or others that place the
        mechanism, and shades count assembly modes. Idle freedoms do not count. Solid singular lines
        are of type 1 (the frame loses a direction); dashed ones are of type 2 (the frame moves
        although both coordinates are held), and there modes meet. Limits of other coordinates are
        lines, too. Counts come from closed forms for planar chains and dyads. Otherwise each
        configuration found is followed from place to place, and more may exist.
        """
        from kempe.views.space_pictures import plot_spaces

        return plot_spaces(
            self,
            frame,
            points=points,
            q=q,
            task=task,
            grid=grid,
            ax=ax,
            resolution=resolution,
            budget=budget,
        )


# ---- the system

ARRAY = np.ndarray
"""Looked up once: bound calls take four microseconds."""


class System(Model, Pictured):
    """Multibody system, compiled from a `Mechanism`.

    Its parts are a spanning tree, loop closures, coordinates and a primitive table.

    Frozen, hashable by content, picklable, safe to share between threads. A configuration `q` is an
    array (..., nq) in the order of `coordinate_names`, in radians and metres; a dict by coordinate
    name is accepted in its place, of a system with loops as what `assemble` closes. Poses are
    relative to body 0, the ground. What the methods take is explained at the functions that they
    name.

    What is needed daily has a name here. Families have one name together: `structure` (what it is
    made of), `configuration_space`, `loops`, `inverse`, `reach`, `symbolic`; what the description
    says, and writes, is the `mechanism`.
    """

    # ---- configurations

    @property
    def mid(self) -> Array:
        """Configuration (nq,) in the middle of the limits.

        A coordinate with one limit or none has the allowed value nearest to neutral.

        It is read-only: `mid.copy()` is one to change.
        """
        return configurations.compute_mid_configuration(self)

    @partial(explain_errors, fast=True)
    def random(
        self, rng: np.random.Generator | int | None = None, shape: int | tuple[int, ...] = ()
    ) -> Array:
        """Draw random configurations, uniformly inside the limits.

        Loops are not closed and relations of several coordinates are not imposed.

        Parameters
        ----------
        rng
            Generator or seed. The same seed gives the same configurations, in any order of
            declaration.
        shape
            Leading shape of the result.

        Returns
        -------
        Array
            Configurations (*shape, nq). Angles without limits lie in [-pi, pi) and lengths without
            limits in [-1, 1) metres; a coordinate with one limit lies within that range of it.
            Orientations are uniform.
        """
        return configurations.sample_configurations(self, rng, shape)

    @partial(explain_errors, fast=True)
    def q(self, coordinates: Mapping[str, float] | str, base: ArrayLike | None = None) -> Array:
        """Make a configuration from values by coordinate name, or from a named posture.

        No loop is closed; `assemble` closes loops.

        Parameters
        ----------
        coordinates
            Values in radians and metres by coordinate name, the name of a posture, or a ROS message
            `JointState`. A coordinate that follows another one may be given if its value fits.
        base
            Configuration (..., nq) with the values of all other coordinates (default: `neutral`).

        Returns
        -------
        Array
            Configuration (..., nq).
        """
        return configurations.make_q(self, coordinates, base)

    @partial(explain_errors, fast=True)
    def q_dict(self, q: ArrayLike) -> dict[str, float]:
        """Convert one configuration (nq,) to values by coordinate name."""
        return configurations.make_q_dict(self, q)

    # ---- groups of joints

    @property
    def groups(self) -> dict[str, tuple[str, ...]]:
        """The names of joints in each group, as an SRDF or `Mechanism.group` declares them."""
        return ReadOnlyDict(self._mechanism.groups)

    @explain_errors
    def group(self, name: str) -> System:
        """Return the system of a group of joints.

        Its ground is the body from which the joints of the group branch off. Bodies that are fixed
        to moving ones come along, and frames, limits, followers and postures as far as they are of
        these joints. Joints between them that are not in the group are held as in `neutral`.

        Parameters
        ----------
        name
            One of `groups`.

        Returns
        -------
        System
            With the coordinates of the group alone, under the same names.

        Raises
        ------
        UnknownNameError
            Where there is no such group.
        DescriptionError
            Where a coordinate of the group follows one outside.
        """
        return type(self)(extract_group(self.mechanism, name, self.q_dict(self.neutral)))

    # ---- the space of configurations

    @cached_property
    def configuration_space(self) -> ConfigurationSpace:
        """Configuration space of the system, with its dimension and its shape, such as T^2 x R."""
        from kempe.spaces.configuration_space import make_configuration_space

        return make_configuration_space(self)

    @explain_errors
    def task_space(
        self,
        tasks: FrameLike | TaskLike,
        q: StartLike | None = None,
        *,
        task: str | None = None,
        budget: Budget | None = None,
    ) -> TaskSpace:
        """Compute the dimension of a task, its ranks, and bounds of its image.

        Parameters
        ----------
        tasks
            Name of a frame, a task of `kempe.tasks`, or a list of tasks.
        q
            Configuration (nq,) at which the rank is computed (default: a random one).
        task
            Part of the frame's pose that counts: "pose" (default) or "position".
        budget
            Reads starts (64 random configurations), rng (0) and time_limit (30 s).

        Returns
        -------
        TaskSpace
            Dimensions, the rank at `q`, and the generic rank at random configurations. The image is
            the range of the frame's origin at random configurations within limits and one-sided
            constraints; a tree has 10 000 more of them. `late` is true if the time limit ended the
            work; the result then rests on the finished `samples`.

        Raises
        ------
        InputError
            For wrong values.
        UnknownNameError
            If there is no such frame.
        TimeLimitError
            If the time limit passes before the first sample.

        Examples
        --------
        >>> import kempe
        >>> print(kempe.load("two_link").task_space("e", task="position").status)
        position of 'e': m = n = 2, rank 2; finitely many configurations reach each point, except at singular ones
        """
        from kempe.spaces.task_space import task_space

        return task_space(self, tasks, q, task=task, budget=budget)

    @explain_errors
    def workspace(
        self,
        frame: FrameLike,
        *,
        kind: str | None = None,
        orientation: ArrayLike | None = None,
        at: ArrayLike | None = None,
        n: float | None = None,
        cells: int | Sequence[int] | None = None,
        box: ArrayLike | None = None,
        client: Client | str | None = None,
        path: str | FilePath | None = None,
        budget: Budget | None = None,
    ) -> Workspace:
        """Compute the workspace of a frame as a map of random samples.

        Parameters
        ----------
        frame
            Name of the body or frame.
        kind
            "reachable": places in some orientation. "constant-orientation": places in one
            `orientation`. "dexterous": places in several orientations (default: 180 angles in the
            plane, 256 evenly spread rotations in space). "orientation": orientations in which the
            frame reaches the place `at`. Default: "constant-orientation" with one `orientation`,
            "dexterous" with a list of them, "orientation" with `at`, else "reachable".
        orientation
            Angles in radians in the plane; in space rotations (..., 3, 3), or roll, pitch and yaw
            (3,).
        at
            Place (d,) of the frame's origin in metres.
        n
            Number of samples (default: 1e7, with closed loops 1e5; other kinds: one for each cell).
        cells
            Number of cells along the longest edge of the box, or along each axis.
        box
            Bounds (d, 2) of the map in metres (default: those of the first positions, a tenth
            wider).
        client
            A `distributed.Client` or the address of a scheduler: a Dask cluster does the work.
        path
            Path of a Zarr store. The map is written there as it grows. The same call continues
            after an interruption, and a larger `n` adds samples.
        budget
            Reads rng (0), threads, time_limit (none) and progress(samples, n).

        Returns
        -------
        Workspace
            Counts of samples in cells, with `volume` or `area`, `contains` and `boundary`. After
            the time limit it holds the finished samples.

        Raises
        ------
        InputError
            For a frame that does not move, for slides without limits if there is no box, and for a
            path with another map.
        UnknownNameError
            If there is no such frame or kind.
        KernelsError
            For a map of other kernels.
        DiskError
            If the map cannot be written.
        MissingExtraError
            For `client` or `path` without the extra [scale].
        Interrupted
            After Ctrl-C, with the finished samples as its `answer`.

        Notes
        -----
        Samples of a reachable workspace are configurations within limits: uniform coordinates,
        angles without limits in a full turn, uniform quaternions. With closed loops, each sample is
        closed first, and dropped if it violates a constraint; this is about a thousand times
        slower. Samples of the other kinds are random places or orientations, equally many in each
        cell, which inverse kinematics decides; so are samples of systems with slides without limits
        if there is a box.

        Memory does not depend on `n`. The samples depend only on the seed and their number, so any
        number of threads or workers gives the same map.
        """
        from kempe.workspace.workspace import workspace

        return workspace(
            self,
            frame,
            kind=kind,
            orientation=orientation,
            at=at,
            n=n,
            cells=cells,
            box=box,
            client=client,
            path=path,
            budget=budget,
        )

    # ---- where everything is

    if not TYPE_CHECKING:  # else type checkers would accept any name

        def __getattr__(self, name: str) -> NoReturn:
            """Raise the error of a missing member: which one is meant, also by a name that another
            library has for it.
            """
            meant = MEMBERS_ELSEWHERE.get(name) or MEMBERS_WITHIN.get(name)
            raise_missing_member(self, name, f"; did you mean {meant!r}?" if meant else "")

    def fk(
        self,
        q: ConfigurationLike,
        frame: FrameLike | Frames | None = None,
        out: Array | None = None,
        threads: int | None = None,
        form: str | None = None,
        dtype: DTypeLike | None = None,
        relative_to: FrameLike | None = None,
    ) -> Array:
        """Compute the poses of bodies and frames at configurations (forward kinematics).

        Parameters
        ----------
        q
            Configurations (..., nq) in radians and metres, or values by coordinate name.
        frame
            Name of a body or frame, or a list of names. None stands for all bodies in their order,
            body 0 (the ground) included.
        out
            C-contiguous array for the result, of its shape and type.
        threads
            Number of threads for a large batch (default: one for each processor).
        form
            "matrix" (default), "3x4" (the upper three rows), "position" (3 numbers) or
            "position_quat_wxyz" (7 numbers).
        dtype
            "float64" (default) or "float32". Poses are computed in float64 and rounded afterwards.
        relative_to
            Name of the frame from which poses are seen (default: the ground).

        Returns
        -------
        Array
            Poses (..., 4, 4) of one frame, or (..., k, 4, 4) of k frames. Another `form` has its
            own shape in place of (4, 4). Poses of a batch at a configuration with NaN or infinity
            are NaN in their first three rows.

        Raises
        ------
        UnknownNameError
            If there is no such frame.
        InputError
            For wrong shapes, and for a single configuration that is not finite or has a zero
            quaternion on which a pose depends.
        """
        query = (
            self._kept["fk"].get(frame)
            if frame.__class__ is str and form is dtype is relative_to is None
            else None
        )
        # the import below alone would double the time
        if query is not None and q.__class__ is ARRAY:
            return query(None, q, out, threads)
        from kempe.forward.fk import fk

        return fk(self, q, frame, out, threads, form, dtype, relative_to)

    def jacobian(
        self,
        q: ConfigurationLike,
        frame: FrameLike | Frames,
        in_frame: str = "world_aligned",
        threads: int | None = None,
    ) -> Array:
        """Compute the Jacobian of a frame: its twist is the Jacobian times the velocities.

        Parameters
        ----------
        q
            Configurations (..., nq) in radians and metres, or values by coordinate name.
        frame
            Name of a body or frame, or a list of names.
        in_frame
            Frame in which the twist is expressed. "world_aligned": velocity of the frame's origin,
            axes of the ground. "world": velocity of the point at the ground's origin, axes of the
            ground. "body": velocity of the frame's origin, axes of the frame.
        threads
            Number of threads for a large batch (default: one for each processor).

        Returns
        -------
        Array
            Jacobian (..., 6, nv) with the linear rows first, or (..., k, 6, nv) for k frames.

        Raises
        ------
        UnknownNameError
            If there is no such frame, or no such `in_frame`.
        InputError
            As in `fk`.

        Notes
        -----
        Velocities are time derivatives of the coordinates, and for a quaternion the angular
        velocity in the axes of the rotated body. Source: Featherstone, *Rigid Body Dynamics
        Algorithms*, 2008, section 2.8.
        """
        query = self._kept["fk"].get(frame) if frame.__class__ is str else None
        if query is not None and q.__class__ is ARRAY:
            return query.jacobian(q, in_frame, None, threads)
        from kempe.forward.fk import jacobian

        return jacobian(self, q, frame, in_frame, threads)

    @partial(explain_errors, fast=True)
    def query(
        self, frame: FrameLike, form: str | None = None, dtype: DTypeLike | None = None
    ) -> Query:
        """Return the forward kinematics of one frame as a fast function.

        Names are looked up and arrays are packed once, so that later calls are fast.

        Parameters
        ----------
        frame
            Name of a body or frame.
        form, dtype
            Form and number type of the poses, as in `fk`.

        Returns
        -------
        Query
            Function ``f(q, out=None)`` for poses, with the methods ``f.jacobian(q)`` and
            ``f.pose_and_jacobian(q)``.

        Raises
        ------
        UnknownNameError
            If there is no such frame or form.
        InputError
            For another number type.
        """
        from kempe.forward.fk import query

        return query(self, frame, form, dtype)

    @cached_property
    def symbolic(self) -> Symbolic:
        """Kinematic models of the system as formulas, such as `symbolic.fk(frame)`."""
        from kempe.namespaces import Symbolic

        return Symbolic(self)

    @partial(explain_errors, fast=True)
    def ik(
        self,
        target: TargetLike,
        frame: FrameLike | None = None,
        start: StartLike | None = None,
        *,
        task: str | tuple[str, ArrayLike] | None = None,
        prefer: Preference | None = None,
        method: str | None = None,
        tolerance: float | tuple[float, float] | None = None,
        budget: Budget | None = None,
        history: bool = False,
    ) -> Solution:
        """Find a configuration that reaches a target or satisfies tasks (inverse kinematics).

        Parameters
        ----------
        target
            Pose (..., 4, 4) in the ground frame or position (..., 3) of `frame`; in planar systems
            also (..., 3, 3), (..., 2) and, with ``task="pose"``, x, y and angle (..., 3). Also a
            pose of another library, or the name of a frame on the ground. Without a `frame`, one or
            several tasks of `kempe.tasks`, hard or soft, in strict priorities.
        frame
            Name of the body or frame that reaches the target.
        start
            First start: a configuration (..., nq), values by coordinate name, or the name of a
            posture (default: the middle of the limits; for tasks the posture 'closed', if there is
            one). Starts and targets broadcast.
        task
            Part of the target that counts: "pose", "position", "orientation", "direction" (of the
            frame's z axis, or of another axis as in ``("direction", (1, 0, 0))``), or
            "position_axis" (position and direction).
        prefer
            Quantity that is minimised in the freedoms that the tasks leave: "nearest" (distance to
            `start`), "mid" (distance to the middle of the limits), "manipulability" (its inverse),
            or a function of q (nq,). The answer is then `Reached`.
        method
            "numeric" (default); "analytic" (the solution of `ik_all` that is nearest to `start`);
            or "auto" (analytic where the chain allows it, else numeric).
        tolerance
            Largest position error in metres and rotation error in radians, as one number or two
            (default: 1e-6 each).
        budget
            Reads starts (1000), iterations of one start (40), time_limit (30 s for one target, none
            for a batch), rng (0) and threads. For tasks see the notes.
        history
            Keep the iterates of a single target in `Solution.history`.

        Returns
        -------
        Solution or Reached
            Configuration `q` (..., nq) with `success` and a `status` that gives the reason of a
            failure. Where no solution was found, `q` is the nearest configuration found: it
            minimises the sum of squares of the position error in characteristic lengths and the
            rotation error in radians. `Reached` is the answer for tasks, and for a frame that moves
            with closed loops, declared constraints or relations of several coordinates.

        Raises
        ------
        InputError
            For wrong shapes, other words for `task` or `method`, and NaN in a single target. A
            target of a batch with NaN gives NaN.
        UnknownNameError
            If there is no such frame, posture or coordinate.

        Notes
        -----
        Joint limits, couplings and closed loops hold. `start` is tried first; other starts are
        drawn from rng. The first start that reaches the target gives the answer, whatever the
        number of threads. Coordinates that do not move the frame keep their value in `start`. Only
        an answer that the time limit ended depends on the machine, and says so.

        For tasks, iterations are 60. By default 60 starts are tried, and then more: none where a
        proof shows that there is no solution; 30 times the square of the number of limited
        coordinates that the tasks move (300 to 15 000) where a solution outside the limits was
        found; else a tenth of that number. One problem with Python functions ends after 10 000
        calls of them if searches without limits, or for these functions alone, find nothing.

        A `Clearance` among the tasks keeps bodies apart: a success does, as coal measures it on the
        collision shapes. Planes between near shapes are tasks, renewed up to 8 times from each of
        up to 61 starts.

        Sources: damped least squares with an active set of limits and restarts (Levenberg, 1944;
        Sugihara, 2011; Chan and Lawrence, 1988); lower priorities are solved in the null space of
        higher ones (Siciliano and Slotine, 1991).
        """
        if (
            frame.__class__ is str
            and prefer is method is tolerance is budget
            and target.__class__ is ARRAY
            and not history
        ):
            key = (frame, task if task is None else str(task), target.ndim)  # type: ignore[union-attr]
            bound = self._kept["ik"].get(key)
            if (
                bound is not None
                and budget is None
                and (answer := bound(target, start)) is not None
            ):
                return answer
        from kempe.inverse.ik import ik

        return ik(
            self,
            target,
            frame,
            start,
            task=task,
            prefer=prefer,
            method=method,
            tolerance=tolerance,
            budget=budget,
            history=history,
        )

    @partial(explain_errors, fast=True)
    def ik_all(
        self,
        target: PoseLike,
        frame: FrameLike,
        start: StartLike | None = None,
        *,
        task: str | tuple[str, ArrayLike] | None = None,
        fixed: Mapping[str, ArrayLike] | None = None,
        limits: bool | str = False,
        clearance: Constraint | Sequence[Constraint] | None = None,
        tolerance: float | None = None,
        budget: Budget | None = None,
    ) -> Solutions | Modes:
        """Find all configurations in which a frame reaches a target (inverse kinematics).

        Parameters
        ----------
        target
            Pose (..., 4, 4) in the ground frame or position (..., 3); in planar systems also (...,
            3, 3), (..., 2) and, with ``task="pose"``, x, y and angle (..., 3).
        frame
            Name of the body or frame that reaches the target.
        start
            Configuration (nq,) that sorts the solutions, chooses among whole turns, and gives the
            values of joints that do not move the frame or are spare (default: neutral, inside the
            limits).
        task
            Part of the target that counts, as in `ik`.
        fixed
            Values of spare joints by name, for redundant chains: numbers, or arrays with a number
            for each target.
        limits
            False: solutions outside the limits are kept, after those inside. True: they are
            dropped. "turns": also list each solution with all whole turns inside the limits.
        clearance
            `Clearance`, or a list of them: solutions that come nearer are left out, and the status
            counts them (default: none).
        tolerance
            Largest error of a solution in metres and radians (default: 1e-9, or rounding if that is
            larger).
        budget
            Reads threads and time_limit (30 s for one target, none for a batch).

        Returns
        -------
        Solutions or Modes
            Solutions `q` (k, nq), or (..., K, nq) with a `mask` for a batch, sorted by their
            distance to `start`. `complete` states that there are no other isolated solutions,
            `status` why there is none. One pose or position of a frame that moves with closed
            loops, or with joints that follow others, gives the `Modes` of `assembly_modes`.

        Raises
        ------
        UnsupportedError
            For chains with quaternions.
        InputError
            For wrong shapes or values.
        UnknownNameError
            If there is no such frame or joint.

        Notes
        -----
        Spare joints that are not in `fixed` keep their value in `start`. For a target without a
        solution inside the limits there, other values are tried; `Solutions.held` gives the values.
        Solutions that violate one-sided constraints of the system are dropped, and `status` says
        so. Each solution is verified by the forward model. Where the time limit ended the work, the
        known solutions are returned, not `complete`.

        The method `plan` of `inverse` gives the way for a frame: closed form (`kempe.kernels.closed_form`),
        elimination (`kempe.kernels.elimination`) or search.
        """
        plain = (
            frame.__class__ is str
            and start is task is tolerance is budget is clearance is None
            and not limits
        )
        if plain and target.__class__ is ARRAY and target.shape == (4, 4):  # type: ignore[union-attr]
            bound = self._kept["ik_all"].get(
                frame if fixed is None else (frame, *fixed) if fixed.__class__ is dict else None
            )
            if bound is not None and (answer := bound(target, fixed)) is not None:
                return answer
        from kempe.inverse.ik_all import ik_all

        return ik_all(
            self,
            target,
            frame,
            start,
            task=task,
            fixed=fixed,
            limits=limits,
            clearance=clearance,
            tolerance=tolerance,
            budget=budget,
        )

    @explain_errors
    def ik_path(
        self,
        targets: TargetLike,
        frame: FrameLike | None = None,
        start: StartLike | None = None,
        *,
        max_step: float = 0.5,
        restart: bool = False,
        branches: bool | Literal["best"] = False,
        cost: Literal["motion", "limits", "singularities"] | Callable[[Any], float] = "motion",
        closed: bool = False,
        clearance: Constraint | Sequence[Constraint] | None = None,
        tolerance: float | tuple[float, float] | None = None,
        budget: Budget | None = None,
    ) -> IkPath:
        """Find configurations in which a frame follows a sequence of targets without a jump.

        Parameters
        ----------
        targets
            Poses (n, 4, 4) or positions (n, 3) of `frame`, in the plane also (n, 3, 3) or (n, 2).
            Without a `frame`, tasks of `kempe.tasks` whose goals have a leading axis (n).
        frame
            Name of the body or frame that follows the targets.
        start
            Configuration (nq,), values by name or a posture from which the first target is reached,
            as in `ik`.
        max_step
            Largest step in radians and characteristic lengths.
        restart
            Where the path ends, go on from the nearest configuration at the next target that can be
            reached. The path then has a jump.
        branches
            With "best" (or True) paths from several start configurations are tried, those of
            `ik_all` among them, with every number of whole turns that the limits allow. The answer
            is the path that gets farthest, then the one with the fewest jumps, then the cheapest.
        cost
            What makes a path of `branches` cheap: "motion", its length; "limits", how near it comes
            to a limit, as a part of the way from the middle; "singularities", the largest ratio of
            two singular values on it; or a function of the configurations (n, nq) that returns a
            number.
        closed
            The path ends in its first configuration; the last target must be the first one again.
            Joints that the targets leave free are moved back on the way. A path that does not
            return misses its last target, and says so.
        clearance
            `Clearance`, or a list of them. Bodies then keep their distances at the targets and on
            straight ways of the coordinates between them, as `BodyGeometry.check_path` proves it.
            The first target is reached clear of everything, if need be elsewhere. Of `branches`
            the clear ones count. A way that comes too near ends the path, or with `restart` makes
            it jump; the status names the place and the pair, `encounters` has them.
        tolerance
            Largest error in metres and radians (default: 1e-10). A larger value is for rounded
            targets: the path may then leave out what a singularity prevents, within the tolerance.
        budget
            Reads starts (60) and rng (0) of searches, time_limit (600 s) and progress, which
            receives the number of finished targets.

        Returns
        -------
        IkPath
            Configurations `q` (n, nq), the `jumps`, and a `status` that says where and why the path
            jumps or stops. A path that stops does not prove that no continuous path exists.

        Raises
        ------
        InputError
            For wrong shapes or values.
        UnknownNameError
            If there is no such frame.

        Notes
        -----
        Limits, couplings and closed loops hold. Each step starts with the damped pseudoinverse
        times the error (Whitney, 1969). A step is accepted if it is not much longer than that and
        at most `max_step`, or similar to the step before. Otherwise the way between the targets is
        halved (straight lines, rotations by the exponential map). A rotation of joints that leaves
        the way of the targets unchanged is not a jump. Where even the shortest step fails, the path
        is tried again from the start with small self-motions away from the limits, if the targets
        leave freedoms, or away from bodies that come too near for a `clearance`.

        A path that violates velocity constraints by more than the curvature between targets
        explains is refused with its place. If the targets leave freedoms, a path that rolls without
        slip is computed from the first target instead.
        """
        from kempe.inverse.path import ik_path

        return ik_path(
            self,
            targets,
            frame,
            start,
            max_step=max_step,
            restart=restart,
            branches=branches,
            cost=cost,
            closed=closed,
            clearance=clearance,
            tolerance=tolerance,
            budget=budget,
        )

    @partial(explain_errors, fast=True)
    def ik_step(
        self,
        q: ConfigurationLike,
        wanted: TargetLike,
        frame: FrameLike | None = None,
        dt: float = 0.0,
        *,
        velocity_limits: ArrayLike | None = None,
        damping: float = 0.05,
        keep_direction: bool = False,
        weights: ArrayLike | None = None,
    ) -> IkStep:
        """Compute velocities that give a frame a twist, or move it to a pose, within all limits.

        Parameters
        ----------
        q
            Configuration (nq,).
        wanted
            Twist (6,) [linear; angular] of the frame's origin in ground axes, in m/s and rad/s; or
            a pose (4, 4) to reach within `dt`. Without a `frame`, tasks of `kempe.tasks`, hard or
            soft, in strict priorities.
        frame
            Name of the body or frame.
        dt
            Duration of the step in seconds, which has to be given.
        velocity_limits
            Largest speeds: a number or (nv,), in rad/s and m/s. Default: those of the system, else
            pi rad/s and 1 m/s. `math.inf` removes them.
        damping
            Largest damping near singularities. With loops, constraints or tasks it is relative to
            the largest singular value of the Jacobian.
        keep_direction
            Scale the twist to what the limits allow, and keep its direction.
        weights
            Weights (6,) of the rows of the twist; rows with weight zero do not count.

        Returns
        -------
        IkStep
            Velocities, the configuration after `dt`, and the achieved part of the twist.

        Raises
        ------
        InputError
            For wrong shapes or values, without `dt`, and for open loops.
        UnknownNameError
            If there is no such frame.

        Notes
        -----
        The velocities minimise the weighted squared error of the twist and then their own norm, in
        radians and characteristic lengths. Directions in which the frame hardly moves are damped
        (Maciejewski and Klein, 1988). Speeds stay within `velocity_limits`, and coordinates within
        their limits during `dt`; one that is outside goes no further, and may rest. Other joints
        take over gradually where a coordinate reaches a limit, so the result is slightly below that
        of a bounded least-squares problem.

        With `keep_direction` the twist is scaled by the largest factor from 0 to 1 that the limits
        allow, up to a few percent for self-motions. The factor goes to zero at a singular
        configuration; close to it the direction is kept to 1 %. Towards a pose the frame moves
        straight, and turns gradually to the nearest pose where a limit or the border of the
        workspace ends the straight way.

        A pose or tasks out of reach within `dt` are approached; all joints then arrive together.
        Repeated steps come to rest at a local minimum of the error. Saddle points are left, by
        Newton's method where a first-order step does not reduce the error. No joint reverses
        between two such steps with more than a twentieth of its speed limit. The result depends
        only on the arguments.

        Loops and relations of several coordinates stay closed, in the velocities and in the
        resulting configuration. Velocity constraints hold to second order, and one-sided
        constraints as limits do. With a `Clearance` among the tasks no step leads nearer than asked,
        or nearer than before where that was too near: distances are measured after the step.
        """
        if (frame is None or frame.__class__ is str) and weights is None:
            bound = self._kept["ik_step"].get(frame)
            if (
                bound is not None
                and (answer := bound(q, wanted, dt, velocity_limits, damping, keep_direction))
                is not None
            ):
                return answer
        from kempe.inverse.ik_step import ik_step

        return ik_step(
            self,
            q,
            wanted,
            frame,
            dt,
            velocity_limits=velocity_limits,
            damping=damping,
            keep_direction=keep_direction,
            weights=weights,
        )

    @cached_property
    def inverse(self) -> Inverse:
        """Methods about inverse kinematics: `plan`, `sweep`, `arm_angle` and `self_motion`."""
        from kempe.namespaces import Inverse

        return Inverse(self)

    @explain_errors
    def singularities(
        self,
        frame: FrameLike | None = None,
        task: str | None = None,
        *,
        inputs: Iterable[str] | None = None,
        limits: bool = True,
        budget: Budget | None = None,
    ) -> Singularities:
        """Find singular configurations of a frame, or of closed loops, from random starts.

        Parameters
        ----------
        frame
            Name of the body or frame; None for the inputs of closed loops only.
        task
            Part of the frame's motion that counts: "pose", "position" or "orientation", in space
            also "xy", "xz", "yz" (position along two axes) and "direction" (of its z axis). Default
            for a chain: the pose if three joints (in space four) move the frame, else the position.
            Default with closed loops: the pose, or the position for a planar frame with two
            freedoms.
        inputs
            Names of the driven coordinates (default: those marked as actuated).
        limits
            Keep only configurations within limits and one-sided constraints.
        budget
            Reads starts (64, at most a million), rng (0), time_limit (120 s) and progress(starts
            done, all starts).

        Returns
        -------
        Singularities
            Sets of singular configurations with their types. A set that is missing may exist.

        Raises
        ------
        InputError
            For wrong values, and a frame that does not move.
        UnknownNameError
            If there is no such frame, task or coordinate.

        Notes
        -----
        A configuration of a chain is singular if the Jacobian of the task has a smaller rank than
        at almost all configurations. Closed loops have singularities of type 1 (the frame loses
        directions), type 2 (the frame moves although all inputs are held), and constraint
        singularities (the loops allow more motions than elsewhere); see
        `kempe.spaces.singular_types`. Idle freedoms do not count. Sets are distinguished by the
        coordinates that determine them, and for arms with six joints by the names of their
        branches.
        """
        from kempe.spaces.singularities import singularities

        return singularities(self, frame, task, inputs=inputs, limits=limits, budget=budget)

    @cached_property
    def reach(self) -> ReachStudies:
        """Methods about the reach of a frame: `poses`, `place`, `capability`, and exact `planar`."""
        from kempe.namespaces import ReachStudies

        return ReachStudies(self)

    @property
    def geometry(self) -> BodyGeometry:
        """Methods about distances between bodies: `pairs`, `clearance`, `nearest`."""
        from kempe.namespaces import BodyGeometry

        return BodyGeometry(self)

    # ---- closed loops

    @partial(explain_errors, fast=True)
    def assemble(
        self,
        known: KnownValues | None = None,
        start: StartLike | None = None,
        *,
        branch: str | None = None,
        prefer: str | None = None,
        limits: bool = True,
        also: HeldLike = (),
        tolerance: float | str | None = None,
        budget: Budget | None = None,
    ) -> Assembly:
        """Find a configuration that closes all loops, with known coordinates or places of frames.

        Parameters
        ----------
        known
            Values in radians and metres by coordinate name, and positions (..., 3) or poses (...,
            4, 4) by frame name (in planar systems also (..., 2)). Arrays make a batch. "t" is the
            time of equations in time, one number. A coordinate that follows another one may be
            given if its value fits.
        start
            First start: a configuration (..., nq) or values by name (default: the posture 'closed',
            else the middle of the limits). The answer stays close to it.
        branch
            Branch of a planar mechanism of dyads as signs, such as '+-' (see `assembly_modes`), or
            the name of a posture at which the search starts.
        prefer
            "nearest": no small motion within the limits leads nearer to `start`. "continuous": each
            row of a batch starts where the last two rows lead.
        limits
            Keep coordinates inside their limits. One-sided constraints always hold.
        also
            Further constraints of `kempe.constraints` for this call, or functions of q (nq,) that
            must be zero.
        tolerance
            Largest change of the joint placements, in metres and radians, with which the nearest
            mechanism that closes exactly is used; see `idealise`. Where there is no such mechanism,
            the largest residual of a success.
        budget
            Reads starts (20), rng (0), threads, and time_limit (30 s, none for a batch).

        Returns
        -------
        Assembly
            Configuration `q` (..., nq) with `success`. Where a loop stays open, `q` is the
            configuration nearest to closing, and `status` names the open loop and its gap. Rows
            that the time limit ended have the code `OUT_OF_TIME`.

        Raises
        ------
        InputError
            For wrong shapes or values, other words for `branch` or `prefer`, and values of
            followers that do not fit.
        UnknownNameError
            If there is no such coordinate or frame.

        Notes
        -----
        `start` is tried first; other starts are drawn around it from rng, at growing distances.
        Redundant constraints are no obstacle. Source of the method (damped least squares with steps
        of minimum norm): Nakamura and Hanafusa, 1986; Sugihara, 2011. A long sequence with
        ``prefer="continuous"`` that stays away from the places where branches of dyads meet is
        computed in closed form.

        If the time limit ends the search for the nearest exact mechanism, nothing counts as closed,
        and the answer says so. This search is made once for each system.
        """
        from kempe.assemble.assemble import assemble

        return assemble(
            self,
            known,
            start,
            branch=branch,
            prefer=prefer,
            limits=limits,
            also=also,
            tolerance=tolerance,
            budget=budget,
        )

    @partial(explain_errors, fast=True)
    def idealise(
        self, tolerance: float | str | None = "measured", *, budget: Budget | None = None
    ) -> Idealised | None:
        """Find the nearest mechanism that closes exactly and moves, and list what differs.

        Dimensions with small errors, such as rounded or measured ones, can stop a mechanism with
        redundant constraints from moving. Small changes of its joint placements make it exact
        again.

        Parameters
        ----------
        tolerance
            Largest change of a placement in metres and radians; or "measured", the smallest change
            that suffices, up to a hundredth of the system's size; or None, the tolerance of the
            system, else rounding.
        budget
            Reads time_limit (120 s).

        Returns
        -------
        Idealised or None
            The exact mechanism and its changed dimensions. None if the given mechanism closes as it
            is, or if there is no exact mechanism within the tolerance.

        Raises
        ------
        InputError
            For a wrong tolerance.
        TimeLimitError
            If the search did not end within the time limit.
        """
        from kempe.assemble.nearest_exact import idealise

        return idealise(self, tolerance, budget=budget)

    @explain_errors
    def assembly_modes(
        self,
        known: KnownValues | None = None,
        start: StartLike | None = None,
        *,
        limits: bool = True,
        frame: FrameLike | None = None,
        tolerance: float | str | None = None,
        budget: Budget | None = None,
    ) -> Modes:
        """Find all configurations that close the loops with known coordinates or places of frames.

        Parameters
        ----------
        known
            Values in radians and metres by coordinate name, and positions or poses by frame name.
            "t" is the time of equations in time (default: 0).
        start
            Configuration (nq,) that sorts the answer, the nearest first, and chooses among whole
            turns of angles (default: near zero).
        limits
            Drop configurations outside the joint limits. Otherwise `inside` marks the
            configurations inside, and random starts cover whole turns.
        frame
            Name of a frame: configurations with the same pose of this frame count as one. Without
            it, configurations that differ only by idle freedoms count as one.
        tolerance
            Largest change of the joint placements, in metres and radians, with which the nearest
            mechanism that closes exactly is used; see `idealise`.
        budget
            Reads starts (at most 4096), rng (0), time_limit (120 s) and progress(starts, modes).

        Returns
        -------
        Modes
            Configurations `q` (k, nq), each once. `complete` states that there are no others, with
            the `reason`. After the time limit these are the modes found by then.

        Raises
        ------
        InputError
            For values that are not single numbers.
        UnknownNameError
            If there is no such coordinate or frame.
        Interrupted
            After Ctrl-C, with the modes found by then as its `answer`.

        Notes
        -----
        Planar mechanisms of dyads are solved in closed form. Their modes are complete unless a
        branch is undetermined: coinciding centres, links without length, parallel slides, roots
        that merge before others, or whole turns that move a gear. `status` names the dyad, and
        least squares search its branch.

        Other mechanisms are assembled from random starts, and from mirror images and combinations
        of the modes found. `coverage` estimates what was missed. Starts go on while the number of
        modes is odd where it must be even.
        """
        from kempe.assemble.modes import assembly_modes

        return assembly_modes(
            self, known, start, limits=limits, frame=frame, tolerance=tolerance, budget=budget
        )

    @explain_errors
    def independent(
        self,
        q: StartLike | None = None,
        prefer: Iterable[str] = (),
        *,
        tolerance: float | str | None = None,
    ) -> Chart:
        """Choose independent coordinates at a closed configuration; they determine all others.

        Parameters
        ----------
        q
            Closed configuration (nq,) (default: the one that `assemble` finds).
        prefer
            Names of coordinates that must be among the independent ones.
        tolerance
            Largest change of the joint placements, in metres and radians, with which the nearest
            mechanism that closes exactly is used; see `idealise`.

        Returns
        -------
        Chart
            The independent coordinates, with the map to configurations.

        Raises
        ------
        InputError
            If `q` is not closed, or if the preferred coordinates are not independent; with the
            reason.
        UnknownNameError
            If there is no such coordinate.

        Notes
        -----
        The coordinates with the best condition are chosen one by one, by QR with column pivoting of
        the tangent space (Golub, 1965). Angles and lengths come first, then rotation vectors of
        ball joints from `q` on (`B.ex`, `B.ey`, `B.ez` for a joint B), and last the coordinates
        that only move idle freedoms.
        """
        from kempe.mobility.independent import independent

        return independent(self, q, prefer, tolerance=tolerance)

    @cached_property
    def loops(self) -> Loops:
        """Methods about closed loops: `constraints`, `closure_error`, `assembler`, `jacobian`, ..."""
        from kempe.namespaces import Loops

        return Loops(self)

    # ---- degrees of freedom and motion

    @explain_errors
    def mobility(
        self,
        q: StartLike | None = None,
        actuated: Iterable[str] | None = None,
        *,
        local: bool = True,
        rng: np.random.Generator | int = 0,
        clearance: Constraint | Sequence[Constraint] | None = None,
        tolerance: float | str | None = None,
        budget: Budget | None = None,
    ) -> Mobility:
        """Compute the degrees of freedom of the system, with the reasoning.

        Parameters
        ----------
        q
            Configuration (nq,) or values by coordinate name (default: the posture 'closed', else a
            closed configuration that a search finds). The nearest closed configuration is used.
            Where there is none, only the count is given.
        actuated
            Names of joints or coordinates whose control is examined (default: those marked in the
            file).
        local
            Determine the exact local number where the rank does not prove it. False is faster.
        rng
            Generator or seed for generic configurations.
        clearance
            `Clearance`, or a list of them: which bodies touch at the distance to be kept, and what
            these contacts still let move, stands with the one-sided constraints (default: none).
        tolerance
            Largest change of the joint placements, in metres and radians, with which the nearest
            mechanism that closes exactly is used; see `idealise`.
        budget
            Reads time_limit (30 s).

        Returns
        -------
        Mobility
            `gruebler` (count), `rank_dof` (nullity of the loop equations at `q`), `dof` (exact
            local number), redundant constraints and idle freedoms; printed, the reasoning. If the
            time limit ends the search for `dof`, `late` is true and `dof` is None.

        Raises
        ------
        InputError
            For wrong shapes or values.
        UnknownNameError
            If there is no such joint or coordinate.

        Notes
        -----
        Where the three angles of a ball joint are singular coordinates, the joint is examined in
        other angles; `rank` and `local` then refer to these.
        """
        from kempe.mobility.mobility import mobility

        return mobility(
            self,
            q,
            actuated,
            local=local,
            rng=rng,
            clearance=clearance,
            tolerance=tolerance,
            budget=budget,
        )

    @partial(explain_errors, fast=True)
    def classify(
        self,
        q: StartLike | None = None,
        *,
        t: float = 0.0,
        project: bool = False,
        rng: np.random.Generator | int = 0,
        tolerance: float | str | None = None,
        budget: Budget | None = None,
    ) -> Classification:
        """Determine the kind of each constraint, and the dimension that motions can reach.

        Parameters
        ----------
        q
            Configuration (nq,) or values by coordinate name (default: as in `mobility`).
        t
            Time in seconds, for constraints that depend on it.
        project
            Replace a `q` that violates position constraints by the nearest closed configuration.
            `moved` is then its distance. Without it such a `q` is refused.
        rng
            Generator or seed for brackets and for configurations near `q`.
        tolerance
            Largest change of the joint placements, in metres and radians, with which the nearest
            mechanism that closes exactly is used; see `idealise`.
        budget
            Reads time_limit (30 s).

        Returns
        -------
        Classification
            Kind of each constraint ("holonomic", "integrable", "nonholonomic" or "unilateral"), the
            freedoms of position and velocity, the growth vector and the reachable dimension. If the
            time limit ends the search for growth vectors, `late` is true, and growth and reachable
            dimension are None.

        Raises
        ------
        InputError
            For wrong shapes or values, and a `q` that violates constraints without `project`.
        UnsupportedError
            For constraints that are not recorded expressions, by name.
        TimeLimitError
            If the freedoms are not known within the time limit.

        Notes
        -----
        Ranks compare singular values with an estimate of rounding. `doubtful` is true where a
        singular value is close to that estimate.
        """
        from kempe.mobility.classify import classify

        return classify(self, q, t=t, project=project, rng=rng, tolerance=tolerance, budget=budget)

    @explain_errors
    def trace(
        self,
        driver: str | None = None,
        start: StartLike | None = None,
        *,
        hold: Mapping[str, float] | None = None,
        toward: Mapping[str, float] | None = None,
        ways: str = "both",
        limits: bool = True,
        clearance: Constraint | Sequence[Constraint] | None = None,
        tolerance: float | str | None = None,
        budget: Budget | None = None,
    ) -> Motion:
        """Trace the whole branch of a mechanism with one degree of freedom.

        Parameters
        ----------
        driver
            Name of the input coordinate. The path begins with growing values of it; points where it
            turns back are the dead points.
        start
            Configuration (nq,), name of a posture, or known coordinates by name (default: the
            posture 'closed', else the middle of the limits). It is closed first.
        hold
            Values of coordinates that stay fixed, by name.
        toward
            Rates by coordinate name that choose the direction, and the branch if `start` is a
            bifurcation.
        ways
            "both" directions from the start, "forward" only, or "branches": both, and the branches
            at bifurcations (`Path.others`).
        limits
            End the path at joint limits.
        clearance
            `Clearance`, or a list of them: the path ends, either way, at the last point before
            bodies come nearer, on the straight way of the coordinates to the next one, too, and
            `ends` names them (default: none). Of the curves of closed loops between points this
            proves nothing; `step` of the budget brings these together.
        tolerance
            Largest change of the joint placements, in metres and radians, with which the nearest
            mechanism that closes exactly is used; see `idealise`.
        budget
            Reads points (at most 100 000), step (arc length, at most 0.1), time_limit (120 s) and
            progress(points, length).

        Returns
        -------
        Path
            Configurations in their order. The path ends where it closes on itself, at a limit,
            before bodies come nearer than a clearance allows, where it is found to have no end (a
            slide that runs away, gears with a ratio that never closes), or where the budget ends.
            `late` is true after the time limit.

        Raises
        ------
        UnsupportedError
            If more than one degree of freedom remains; the error names it.
        InputError
            For wrong shapes or values.
        UnknownNameError
            If there is no such coordinate or posture.
        Interrupted
            After Ctrl-C, with the finished part as its `answer`.

        Notes
        -----
        The path goes straight on where branches cross or touch, and back along itself at a cusp.
        Where branches touch to third order, or more than two touch, a path that does not start
        there may end or change to another branch.

        Examples
        --------
        >>> from kempe import Mechanism
        >>> m = Mechanism("slider-crank", dim=2)
        >>> crank, rod, slider = m.body("crank"), m.body("rod"), m.body("slider")
        >>> _ = m.revolute("A", m.ground, crank)
        >>> _ = m.revolute("B", crank, rod, at=(1, 0))
        >>> _ = m.revolute("C", rod, slider, at=(2, 0))
        >>> _ = m.prismatic("S", m.ground, slider, axis=(1, 0))
        >>> path = m.build().trace("S", {"A": 0.5})
        >>> path.closed, [round(e.value, 9) for e in path.turning_points]
        (True, [3.0, 1.0])
        """
        from kempe.motion.trace import trace

        return trace(
            self,
            driver,
            start,
            hold=hold,
            toward=toward,
            ways=ways,
            limits=limits,
            clearance=clearance,
            tolerance=tolerance,
            budget=budget,
        )

    @explain_errors
    def drive(
        self,
        inputs: Inputs,
        times: ArrayLike | None = None,
        start: StartLike | None = None,
        *,
        hold: Mapping[str, float] | None = None,
        toward: Mapping[str, float] | None = None,
        limits: bool = True,
        clearance: Constraint | Sequence[Constraint] | None = None,
        tolerance: float | str | None = None,
        budget: Budget | None = None,
    ) -> Drive:
        """Compute the continuous motion that follows prescribed inputs, on the branch of the start.

        Parameters
        ----------
        inputs
            Values by coordinate name in radians or metres: an array (n,), one number, or a function
            of time.
        times
            Growing times (n,) in seconds; functions and equations in time need them.
        start
            Configuration (nq,), name of a posture, or known coordinates by name (default: the
            posture 'closed', or the configuration of the first inputs).
        hold
            Values of coordinates that stay fixed, by name.
        toward
            Rates by coordinate name that choose the branch if `start` is a change point (default:
            the branch that moves least).
        limits
            Keep coordinates inside their limits.
        clearance
            `Clearance`, or a list of them: the motion stops at the last sample before bodies come
            nearer, on the straight way of the coordinates to the next one, too, and the status
            names them (default: none). Of the curves of closed loops between samples this proves
            nothing.
        tolerance
            Largest change of the joint placements, in metres and radians, with which the nearest
            mechanism that closes exactly is used; see `idealise`.
        budget
            Reads step (arc length, at most 0.1), time_limit (600 s) and progress(sample, total).

        Returns
        -------
        Drive
            Closed configurations `q` (n, nq), one for each sample. Where the inputs cannot be
            reached, the last configuration is `held`. After the time limit these are the finished
            samples.

        Raises
        ------
        UnsupportedError
            If the inputs leave freedoms or contradict each other.
        InputError
            For wrong shapes or values.
        UnknownNameError
            If there is no such coordinate or posture.
        Interrupted
            After Ctrl-C, with the finished samples as its `answer`.

        Notes
        -----
        Samples may be coarse: between them the motion is continued in steps of arc length. It goes
        straight on through change points. With velocity constraints, the other coordinates roll
        along from the first values of the inputs, and the motion ends before it slips; `status`
        gives the place. `toward` and the step do not count then.

        Examples
        --------
        >>> from kempe import Mechanism
        >>> m = Mechanism("parallelogram", dim=2)
        >>> left, bar, right = m.body("left"), m.body("bar"), m.body("right")
        >>> _ = m.revolute("A", m.ground, left)
        >>> _ = m.revolute("B", left, bar, at=(1, 0))
        >>> _ = m.revolute("C", bar, right, at=(3, 0), child_at=(1, 0))
        >>> _ = m.revolute("D", m.ground, right, at=(3, 0))
        >>> motion = m.build().drive({"A": [0.0, 2.0, 4.0, 6.0]})
        >>> motion.values("D").round(9).tolist(), len(motion.singular_points)
        ([0.0, 2.0, 4.0, 6.0], 1)
        """
        from kempe.motion.drive import drive

        return drive(
            self,
            inputs,
            times,
            start,
            hold=hold,
            toward=toward,
            limits=limits,
            clearance=clearance,
            tolerance=tolerance,
            budget=budget,
        )

    @explain_errors
    def manoeuvre(
        self,
        start: StartLike,
        goal: StartLike,
        *,
        radius: float | None = None,
        budget: Budget | None = None,
    ) -> Manoeuvre:
        """Find a motion of a rolling system from one configuration to another, without slip.

        Parameters
        ----------
        start, goal
            Configurations (nq,) or values by coordinate name; coordinates without a value are
            neutral.
        radius
            Smallest turning radius of the axle's midpoint in metres; 0 allows turns on the spot
            (default: the radius at the steering limits, else 0).
        budget
            Reads points (200) and time_limit (30 s).

        Returns
        -------
        Manoeuvre
            Configurations `q` (n, nq) at times `t` (n,), about as many as the points of the budget,
            the ends of all pieces among them. Angles of wheels end where the motion brings them,
            whatever the goal says.

        Raises
        ------
        UnsupportedError
            For systems without a known manoeuvre; with the reason.
        InputError
            For wrong shapes or values.
        UnknownNameError
            If there is no such coordinate.

        Notes
        -----
        The system is a body that moves in a plane by two slides and a rotation, with an axle that
        does not slip sideways: a knife edge, a unicycle, an upright coin, a differential drive, or
        a car with one steering angle. The axle may be anywhere on the body. Other coordinates may
        be idle, steer, or follow.

        With a radius, the axle takes the shortest path of Reeds and Shepp (1990), and the heading
        may end whole turns away from its value in `goal`. The axle moves at up to 1 m/s and turns
        at up to 1 rad/s, or slower by the velocity limits of the system.
        """
        from kempe.motion.manoeuvre import manoeuvre

        return manoeuvre(self, start, goal, radius=radius, budget=budget)

    @explain_errors
    def simulate(
        self,
        duration: float,
        start: StartLike | None = None,
        *,
        inputs: Inputs | None = None,
        velocity: ArrayLike | None = None,
        acceleration: ArrayLike | None = None,
        restitution: float = 1.0,
        tolerance: float | None = None,
        budget: Budget | None = None,
    ) -> Simulation:
        """Simulate the motion under given velocities, or the flight of a bouncing ball.

        Parameters
        ----------
        duration
            Duration in seconds; time starts at 0.
        start
            Configuration (nq,), values by name, or the name of a posture.
        inputs
            Velocities by name: numbers, or functions of time in seconds. A name is a velocity
            coordinate, or a component of a frame's twist in its own axes such as "car.vx" [m/s] or
            "car.wz" [rad/s]. Without inputs, one ball or particle falls and bounces.
        velocity
            Initial velocity (nv,) of the ball (default: at rest).
        acceleration
            Uniform acceleration (3,) of the ball in m/s^2 (default: 9.81 along -z, in the plane
            along -y).
        restitution
            Ratio of the normal speeds after and before an impact, from 0 to 1.
        tolerance
            Local error of the integration of `inputs` (default: 1e-11).
        budget
            Reads points (200) and time_limit (600 s).

        Returns
        -------
        Simulation
            Configurations and velocities at evenly spread times, and at the times of all events.

        Raises
        ------
        UnsupportedError
            For motions that need masses, with the reason.
        InputError
            For wrong shapes or values, and a start inside a plane.
        UnknownNameError
            If there is no such coordinate or frame.

        Notes
        -----
        With `inputs`, the other velocities follow from velocity constraints and closed loops.
        Position constraints hold at each sample to rounding. The motion ends where a coordinate
        reaches a limit, or where the inputs are impossible.

        Without `inputs`, the body bounces on smooth planes: contacts, other inequalities, and
        limits of its slides. Times of impacts have a closed form, also beyond the infinitely many
        bounces that end at t1 + 2 v / (a (1 - e)), where v is the normal speed after the impact at
        t1, a the acceleration and e the restitution. With moving planes, an impact reverses the
        rate of the gap, a resting body moves along while the plane pushes, and times of impacts are
        found numerically from the gap at 1024 times.
        """
        from kempe.motion.simulate import simulate

        return simulate(
            self,
            duration,
            start,
            inputs=inputs,
            velocity=velocity,
            acceleration=acceleration,
            restitution=restitution,
            tolerance=tolerance,
            budget=budget,
        )

    # ---- other systems from this one

    def with_parameters(self, **numbers: ArrayLike) -> System | Designs[System]:
        """Return the system with other parameter values, or a batch of designs.

        Parameters
        ----------
        **numbers
            Values by parameter name. Arrays broadcast to one shape.

        Returns
        -------
        System or Designs
            A system for plain numbers; `Designs` if a value is an array.

        Raises
        ------
        UnknownNameError
            If there is no such parameter.
        InputError
            For values that are not numbers, and shapes that do not fit together.
        UnsupportedError
            For arrays on which a coupling depends.
        """
        from kempe.designs import with_parameters

        return with_parameters(self, numbers)

    @partial(explain_errors, fast=True)
    def open_loops(self, joints: str | Iterable[str] | None = None) -> System:
        """Return the system without the given joints: the open chain or tree of a closed loop.

        Each moving body keeps a frame at the joint, called "C on rocker" for a joint C of the body
        rocker. Postures, locks and groups lose the removed coordinates.

        Parameters
        ----------
        joints
            Name of a joint, or several (default: the joints that the spanning tree left out).

        Returns
        -------
        System
            The opened system.

        Raises
        ------
        UnknownNameError
            If there is no such joint.
        InputError
            If there is no joint to remove.
        DescriptionError
            If a body would be detached, or if a coupling or constraint needs a removed coordinate.
        """

        return open_loops(self, joints)

    @partial(explain_errors, fast=True)
    def with_limits(
        self,
        limits: Limits | None = None,
        velocity: Mapping[str, float | None] | ArrayLike | None = None,
    ) -> System:
        """Return the system with other limits; tree, coordinates and postures stay the same.

        Parameters
        ----------
        limits
            Pairs (lower, upper) in radians and metres by coordinate name, or an array (nv, 2). None
            stands for no limit, as a pair or as one of its ends.
        velocity
            Largest speeds in rad/s and m/s: one number, an array (nv,), or values by name with None
            for no limit.

        Returns
        -------
        System
            The system with these limits. Coordinates without a name keep their limits.

        Raises
        ------
        UnknownNameError
            If there is no such coordinate.
        InputError
            For wrong values, and limits that a coupled coordinate does not allow.
        """
        from kempe.forward.limits import with_limits

        return with_limits(self, limits, velocity)
