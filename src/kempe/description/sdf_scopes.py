"""Names in SDF models and worlds: frames placed on one another, and included files."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterable, Iterator
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import NamedTuple

import numpy as np

from kempe.description.packages import Folders
from kempe.description.sdf_elements import (
    NEWEST,
    Version,
    check_attributes,
    check_known_children,
    find_first_child,
    get_child_text,
    parse_truth,
    parse_version,
    read_pose,
    read_version,
)
from kempe.description.source import Findings, read_bounded_file, shorten_text
from kempe.description.xml import XmlElement, parse_xml
from kempe.errors import DescriptionError, Where
from kempe.poses import Placement, place
from kempe.spatial import Array

# ---- included files

DEEPEST = 50
MOST = 10_000
"""Models inside one another, included ones counted, and models that are included, at most."""
ENVIRONMENT = ("GZ_SIM_RESOURCE_PATH", "SDF_PATH", "IGN_GAZEBO_RESOURCE_PATH", "GAZEBO_MODEL_PATH")
"""Names of lists of folders with models."""


def list_gazebo_folders() -> list[Path]:
    """Return the folders of models that Gazebo names in environment variables."""
    listed = (os.environ.get(name, "") for name in ENVIRONMENT)
    return [Path(d) for text in listed for d in text.split(os.pathsep) if d and os.path.isdir(d)]


class Include(NamedTuple):
    """Included file: its outermost element, the model in it, and the folder of the file."""

    sdf: XmlElement
    model: XmlElement | None
    folder: Path


class Files:
    """Files that a description includes, each read once, from readable folders only."""

    def __init__(self, roots: Iterable[Path], findings: Findings):
        self.folders = Folders(roots)
        self.findings = findings
        self.count = 0
        self._read: dict[Path, XmlElement] = {}

    def read_include(
        self, element: XmlElement, folder: Path | None, subject: str
    ) -> Include | None:
        """Return what an <include> in a file of the `folder` names; None after recording a problem."""
        uri = find_first_child(element, "uri")
        allowed = "write <include><uri>model://name</uri></include>"
        if uri is None or not uri.content:
            self.findings.add_problem("it has no <uri>", subject, element.location, allowed)
            return None
        before = len(self.findings.problems)
        path = self._find_file(uri, folder, subject)
        if path is None:
            return None
        sdf = self._parse_file(path, uri, subject)
        if sdf is None:
            return None
        self.count += 1
        if self.count > MOST:
            self.findings.add_problem(
                f"more than {MOST} models are included",
                subject,
                uri.content_location,
                "this is no robot's file",
            )
            self.findings.raise_problems()
        models = sdf.find_children("model")
        if len(models) > 1 or (
            not models and not (sdf.find_children("light") or sdf.find_children("actor"))
        ):
            count = len(models) or "no"
            self.findings.add_problem(
                f"{shorten_text(path)} has {count} models",
                subject,
                uri.content_location,
                "an included file has one <model> directly in <sdf>",
            )
        if len(self.findings.problems) > before:
            return None
        return Include(sdf, models[0] if models else None, path.parent)

    def _parse_file(self, path: Path, uri: XmlElement, subject: str) -> XmlElement | None:
        """Return the outermost element of an SDF file, read once; None after recording a problem."""
        if path in self._read:
            return self._read[path]
        try:
            sdf = parse_xml(read_bounded_file(path), str(path), self.findings)
        except DescriptionError as error:
            self.findings.problems += error.problems
            return None
        except OSError as error:
            said = f"{shorten_text(path)} cannot be read: {error.strerror or error}"
            self.findings.add_problem(said, subject, uri.content_location, "check its permissions")
            return None
        if sdf.tag != "sdf":
            said = f"{shorten_text(path)} is no SDF: its outermost element is <{sdf.tag}>"
            self.findings.add_problem(said, subject, uri.content_location, "include SDF files")
            return None
        self._read[path] = sdf
        return sdf

    def _find_file(self, uri: XmlElement, folder: Path | None, subject: str) -> Path | None:
        """Return the file that a <uri> means; None after recording a problem."""
        text = uri.content
        scheme, colon, rest = text.partition("://")
        path = rest if colon else text
        parts = PurePosixPath(path.replace("\\", "/")).parts
        said = ""
        allowed = "write model://name, or a relative path"
        if colon and scheme not in ("model", "package", "file"):
            said = "it is not on this machine"
            allowed = "download the model, and name its folder by package_dirs"
        elif not parts or "\0" in path:
            said = "it names no file"
        elif path.startswith(("/", "\\", "~")) or re.match(r"[A-Za-z]:", path):
            said = "it is absolute"
        if not said:
            package = self.folders.packages.get(parts[0])
            named = [package.joinpath(*parts[1:])] if package is not None else []
            near = [folder] if folder is not None else []
            relative = [d.joinpath(*parts) for d in (*near, *self.folders.roots)]
            order = [*named, *relative] if scheme in ("model", "package") else [*relative, *named]
            places = (file for file in map(_find_sdf_file, order) if file is not None)
            found, outside = self.folders.find_first_file(places, package)
            if found is not None:
                return found
            said = (
                "it leads out of the folders of the model" if outside else "there is no such model"
            )
            looked = ", ".join(repr(str(d)) for d in self.folders.readable) or "no folder"
            allowed = f"looked in {looked}; name others by package_dirs"
        self.findings.add_problem(
            f"{shorten_text(text, 200)}: {said}", subject, uri.content_location, allowed
        )
        return None


def _find_sdf_file(path: Path) -> Path | None:
    """Return the SDF file of a path: itself, or the newest one in the model.config of a folder."""
    try:
        if os.path.isfile(path):
            return path
        config = path / "model.config"
        if not os.path.isfile(config):
            inside = path / "model.sdf"
            return inside if os.path.isfile(inside) else None
        names = parse_xml(read_bounded_file(config), str(config)).find_children("sdf")
    except (OSError, ValueError, DescriptionError):
        return None
    best: tuple[Version, Path] | None = None
    for name in names:
        version = parse_version(name.attributes.get("version", "1.0"))
        file_path = path / name.content
        if version <= NEWEST and os.path.isfile(file_path) and (best is None or version > best[0]):
            best = version, file_path
    return best[1] if best else None


# ---- frames

GROUND = "world"
"""The name of what does not move."""
MODEL = "__model__"
"""The name of a model's own frame, inside of it."""
FEW = 8
"""Frames over which numbers of the file are kept as they are, without multiplying poses."""


class Node(NamedTuple):
    """Frame of a scope: it sits at `X` on the frame `base`, and moves with the frame `on`.

    `on` is '' for a link, which moves by itself.
    """

    X: Placement
    base: str
    on: str
    where: Where


class Scope:
    """Model or world as a scope of names: links, joints, frames, nested models.

    A nested model is a frame of its scope, and has its own scope in `models`. A merged one has its
    names in the outer scope, too.
    """

    def __init__(
        self,
        element: XmlElement,
        name: str,
        outer: Scope | None,
        version: Version,
        folder: Path | None,
        files: Files,
    ):
        self.element = element
        self.name = name
        self.outer = outer
        self.version = version
        self.folder = folder
        self.files = files
        self.findings = files.findings
        self.merged = False
        self.placing = element
        """The element that has the <pose> of the model: itself, or the <include> that names it."""
        self.depth = outer.depth + 1 if outer else 0
        self.links: dict[str, XmlElement] = {}
        self.joints: dict[str, XmlElement] = {}
        self.frames: dict[str, XmlElement] = {}
        self.models: dict[str, Scope] = {}
        self._order: list[str] = []
        self._nodes: dict[str, Node] = {}
        self._poses: dict[str, Array] = {self.root: np.eye(4)}

    @property
    def is_world(self) -> bool:
        """Whether the scope is a world, whose frame does not move."""
        return self.element.tag == "world"

    @property
    def root(self) -> str:
        """Name of the scope's own frame, inside the scope."""
        return GROUND if self.is_world else MODEL

    @cached_property
    def prefix(self) -> str:
        """Prefix of the scope's names in the mechanism: 'arm::hand::'."""
        if self.outer is None:
            return ""
        return self.outer.prefix if self.merged else f"{self.outer.prefix}{self.name}::"

    @property
    def subject(self) -> str:
        """Name of the scope in messages."""
        return f"{self.element.tag} {(self.prefix.removesuffix('::') or self.name)!r}"

    def describe_part(self, kind: str, name: str) -> str:
        """Return the name of a part of the scope in messages: "joint 'arm::elbow'"."""
        return f"{kind} {self.prefix + name!r}"

    def iterate_scopes(self) -> Iterator[Scope]:
        """Iterate over the scope and the scopes nested in it, in the order of the file."""
        yield self
        for inner in self.models.values():
            yield from inner.iterate_scopes()

    @cached_property
    def static(self) -> bool:
        """Whether the model, or a model around it, is static."""
        outer = self.outer is not None and self.outer.static
        if outer or self.merged or self.is_world:
            return outer
        holder = self.placing if find_first_child(self.placing, "static") else self.element
        element = find_first_child(holder, "static")
        return element is not None and parse_truth(
            element.content, element.content_location, self.findings, self.subject, "static"
        )

    # what stands in a scope

    def scan_elements(self, only: str | None = None) -> None:
        """Collect the links, joints, frames and models; in a world `only` the model of this name."""
        check_known_children(self.element, self.findings, self.subject, DRAKE)
        check_attributes(self.element, self.findings, self.subject)
        for child in self.element.children:
            if child.tag == "include":
                self._include_model(child, only)
            elif child.tag in ("link", "joint", "frame", "model"):
                name = child.attributes.get("name", "").strip()
                if only is not None and (child.tag != "model" or name != only):
                    continue
                self._add_element(child, name, only)
        if not self.is_world:
            self._check_placement_frame()

    def _add_element(self, child: XmlElement, name: str, only: str | None) -> None:
        """Collect a link, joint, frame or model under its name."""
        findings = self.findings
        if not name:
            findings.add_problem(f"a {child.tag} has no name", self.subject, child.location, NAMED)
            return
        subject = self.describe_part(child.tag, name)
        check_attributes(child, findings, subject)
        reserved = name == GROUND or (name.startswith("__") and name.endswith("__"))
        if self.version >= (1, 7) and reserved or name == GROUND and child.tag == "link":
            findings.add_problem(
                f"the name {name!r} is reserved",
                subject,
                child.locate_attribute("name"),
                "rename it: world and __...__ have a meaning of their own",
            )
        elif self.version >= (1, 8) and "::" in name:
            findings.add_problem(
                f"its name {name!r} holds '::'",
                subject,
                child.locate_attribute("name"),
                "rename it: '::' stands between the names of nested models",
            )
        elif self._is_new_name(child, name, subject):
            if child.tag == "model":
                self._nest_model(
                    Scope(child, name, self, self.version, self.folder, self.files), only
                )
            else:
                table = {"link": self.links, "joint": self.joints, "frame": self.frames}[child.tag]
                table[name] = child
                self._order += [name] * (child.tag == "link")

    def _is_new_name(self, child: XmlElement, name: str, subject: str) -> bool:
        """Whether no other part has this name; before version 1.7 kinds are separate."""
        tables = {"link": self.links, "joint": self.joints, "frame": self.frames}
        for kind, table in {**tables, "model": self.models}.items():
            other = table.get(name)
            if other is not None and (kind == child.tag or self.version >= (1, 7)):
                there = other.element if isinstance(other, Scope) else other
                message = f"there is another {kind} of this name, at {there.location}"
                where = child.locate_attribute("name")
                self.findings.add_problem(message, subject, where, "names must be unique")
                return False
        return True

    def _nest_model(self, inner: Scope, only: str | None) -> None:
        """Add a nested model; the names of the `only` model have no prefix."""
        if inner.depth > DEEPEST:
            self.findings.add_problem(
                f"models are nested more than {DEEPEST} deep",
                self.subject,
                inner.placing.location,
                "this is no robot's file",
            )
            self.findings.raise_problems()
        if only is not None:
            inner.prefix = ""
        self.models[inner.name] = inner
        self._order += [inner.name] * inner.merged
        inner.scan_elements()

    def _include_model(self, element: XmlElement, only: str | None) -> None:
        """Add the model of an <include>."""
        findings = self.findings
        given = get_child_text(element, "name")
        subject = f"include {given!r}" if given else "include"
        if only is not None and given and given != only:
            return
        check_known_children(element, findings, subject)
        check_attributes(element, findings, subject)
        for child in element.find_children("experimental:params"):
            findings.add_problem(
                "<experimental:params> is not read, and it changes the included model",
                subject,
                child.location,
                "write the model as it shall be",
            )
        before = len(findings.problems)
        found = self.files.read_include(element, self.folder, subject)
        if found is None and only is not None:
            del findings.problems[before:]  # it may be another model that cannot be found
        if found is None or found.model is None:
            return  # a light or an actor does not move anything
        name = given or found.model.attributes.get("name", "").strip()
        if only is not None and name != only:
            return
        version = read_version(found.sdf, findings)
        inner = Scope(found.model, name, self, version, found.folder, self.files)
        inner.placing = element
        merge = element.attributes.get("merge")
        inner.merged = parse_truth(
            merge, element.locate_attribute("merge"), findings, subject, "merge"
        )
        if inner.merged:
            inner.name = f"_merged__{name}__model__"
        if not name:
            findings.add_problem("the included model has no name", subject, element.location, NAMED)
        elif self._is_new_name(found.model, inner.name, subject):
            self._nest_model(inner, only)
        if inner.merged and self.is_world and (inner.links or inner.frames.keys() & self.frames):
            findings.add_problem(
                "it merges links into a world",
                subject,
                element.location,
                "links belong to a model: leave out merge",
            )

    # frames

    def _check_placement_frame(self) -> None:
        """Record a problem where the canonical link or the placement frame does not exist."""
        attribute = self.element.attributes.get("canonical_link")
        if attribute and self.find_frame(attribute) is None:
            self.record_unknown_name(
                "canonical_link", attribute, self.element.locate_attribute("canonical_link")
            )

    @cached_property
    def outer_placement(self) -> Placement:
        """Placement of the model on the frame that its <pose> names, by its placement frame if any."""
        holder = self.placing
        if find_first_child(holder, "pose") is None and self.placing is not self.element:
            holder = self.element
        X = read_pose(holder, self.findings, self.subject)[0]
        name = get_child_text(self.placing, "placement_frame")
        where = self.placing.location
        if not name:
            name = self.element.attributes.get("placement_frame", "")
            where = self.element.locate_attribute("placement_frame")
        if not name or self.find_frame(name) is None:
            if name:
                self.record_unknown_name("placement_frame", name, where)
            return X
        return X @ self.place_on_root(name).invert_steps()

    @cached_property
    def reference_frame(self) -> tuple[str, Where]:
        """Name of the frame to which the model's <pose> is relative, and its place in the file."""
        holder = (
            self.placing if find_first_child(self.placing, "pose") is not None else self.element
        )
        pose = find_first_child(holder, "pose")
        if pose is None:
            return "", holder.location
        given = pose.attributes
        return given.get("relative_to") or given.get("frame") or "", pose.location

    @cached_property
    def world_pose(self) -> Array:
        """Pose (4, 4) of the scope's own frame in the world."""
        if self.outer is None:
            if self.is_world:
                return np.eye(4)
            name, where = self.reference_frame
            if name and name != GROUND:
                self.findings.add_problem(
                    f"its pose is relative to {name!r}",
                    self.subject,
                    where,
                    "outside of a world there is no frame but the world's",
                )
            return self.outer_placement.evaluate_pose({})
        return self.outer.world_pose @ self.outer.compute_pose(self.name)

    def find_frame(self, name: str) -> str | None:
        """Return the key of the frame that a name means in this scope; None where there is none."""
        if name == self.root:
            return name
        known = name in self.links or name in self.models or name in self.frames
        if known or name in self.joints or name in self._nodes:
            return name
        head, separator, rest = name.partition("::")
        if separator and head in self.models and self.models[head].find_frame(rest) is not None:
            return name
        for inner in self.models.values():
            if inner.merged and name != MODEL and inner.find_frame(name) is not None:
                return f"{inner.name}::{name}"
        return None

    def record_unknown_name(self, what: str, name: str, where: Where, subject: str = "") -> None:
        """Record a problem for a name that means nothing in this scope."""
        names = [*self.links, *self.frames, *self.joints, *self.models]
        said = self.findings.suggest_name(name, names)
        self.findings.add_problem(
            f"{what} is {shorten_text(name)}, which is no frame of {self.subject}{said}",
            subject or self.subject,
            where,
            "" if said else "it must name a link, frame, joint or model of the same model",
        )

    def _find_node(self, key: str) -> Node:
        """Return the frame of a key; a frame is read when it is first needed."""
        node = self._nodes.get(key)
        if node is None:
            node = self._nodes[key] = self._make_node(key)
        return node

    def _make_node(self, key: str) -> Node:
        """Return a new node for the frame of a key."""
        head, separator, rest = key.partition("::")
        if key in self.links:
            return self._place_node(key, self.links[key], "link", self.root, "")
        if key in self.models:
            inner = self.models[key]
            name, where = inner.reference_frame
            base = self._resolve_reference("relative_to", name, where, inner.subject) or self.root
            return Node(inner.outer_placement, base, f"{key}::{MODEL}", where)
        if key in self.frames:
            element = self.frames[key]
            given = element.attributes.get("attached_to", "")
            subject = self.describe_part("frame", key)
            where = element.locate_attribute("attached_to")
            on = self._resolve_reference("attached_to", given, where, subject) or self.root
            return self._place_node(key, element, "frame", on, on)
        if key in self.joints:
            element = self.joints[key]
            child = find_first_child(element, "child")
            where = child.content_location if child is not None else element.location
            subject = self.describe_part("joint", key)
            on = (
                self._resolve_reference("child", get_child_text(element, "child"), where, subject)
                or self.root
            )
            return self._place_node(key, element, "joint", on, on)
        assert separator, "find gives no other keys"
        inner = self.models[head]
        return Node(inner.place_on_root(rest), head, key, inner.element.location)

    def _place_node(self, key: str, element: XmlElement, kind: str, default: str, on: str) -> Node:
        """Return a new node for a frame, placed by the <pose> of its element."""
        subject = self.describe_part(kind, key)
        X, relative, pose = read_pose(element, self.findings, subject)
        where = pose.location if pose is not None else element.location
        base = self._resolve_reference("relative_to", relative, where, subject) or default
        return Node(X, base, on, where)

    def _resolve_reference(self, what: str, name: str, where: Where, subject: str) -> str:
        """Return the key of a frame that the file names; '' where the name is missing or wrong."""
        if not name:
            return ""
        key = self.find_frame(name)
        if key is None:
            self.record_unknown_name(what, name, where, subject)
        return key or ""

    def _list_ancestors(self, key: str, most: int) -> list[str]:
        """Return the keys from a frame down to the scope's own frame, at most `most` of them."""
        out: dict[str, None] = {}
        while key != self.root and key not in self._poses and len(out) < most:
            if key in out:
                names = [*out][[*out].index(key) :]
                shown = " -> ".join(map(repr, [*names[:8], *(["..."] if names[8:] else []), key]))
                self.findings.add_problem(
                    f"its pose is relative to itself: {shown}",
                    f"frame {self.prefix + key!r}",
                    self._find_node(key).where,
                    "the frames of a model sit on one another, and the first one on the model",
                )
                self.findings.raise_problems()
            out[key] = None
            key = self._find_node(key).base
        return [*out]

    def compute_pose(self, name: str) -> Array:
        """Return the pose (4, 4) of a frame in the scope's own frame."""
        key = self.find_frame(name) or self.root
        for part in reversed(self._list_ancestors(key, sys.maxsize)):
            node = self._find_node(part)
            self._poses[part] = self._poses[node.base] @ node.X.evaluate_pose({})
        return self._poses[key]

    def place_on_root(self, name: str) -> Placement:
        """Return the placement of a frame on the scope's own frame."""
        exact = self.find_relative_placement(self.find_frame(name) or self.root, self.root)
        return place(self.compute_pose(name)) if exact is None else exact

    def compute_world_pose(self, name: str) -> Array:
        """Return the pose (4, 4) of a frame, or of the ground, in the world."""
        return np.eye(4) if name == GROUND else self.world_pose @ self.compute_pose(name)

    def find_relative_placement(self, key: str, other: str) -> Placement | None:
        """Return the placement of a frame on another frame of this scope as the file gives it.

        None where the first does not sit on the second, over a few frames.
        """
        out = Placement()
        for _ in range(FEW):
            if key == other:
                return out
            if key == self.root:
                return None
            node = self._find_node(key)
            out = node.X @ out
            key = node.base
        return None

    # links

    def find_link(self, name: str, where: Where, subject: str) -> tuple[Scope, str] | None:
        """Return the link that moves with a frame, as its scope and its name; None after a problem.

        The name is '' for the ground.
        """
        scope: Scope = self
        key = GROUND if name == GROUND else self.find_frame(name)
        seen: set[tuple[int, str]] = set()
        while key is not None:
            if key == GROUND:
                return scope, ""
            if (id(scope), key) in seen:
                break
            seen.add((id(scope), key))
            if key in scope.links:
                return scope, key
            head, separator, rest = key.partition("::")
            if key == MODEL:
                canonical = scope.canonical_link
                if canonical is None:
                    self.findings.add_problem(
                        f"{name!r} moves with {scope.subject}, which has no link",
                        subject,
                        where,
                        "name a frame that moves with a link",
                    )
                    return None
                key = canonical
            elif separator and head in scope.models and key not in scope.own_names:
                scope = scope.models[head]
                key = scope.find_frame(rest)
            elif key in scope.models:
                scope = scope.models[key]
                key = MODEL
            else:
                key = scope._find_node(key).on
        if key is not None:
            said = f"{name!r} is attached to itself"
            allowed = "frames are attached to one another, and the first one to a link"
            self.findings.add_problem(said, subject, where, allowed)
        return None

    @property
    def own_names(self) -> set[str]:
        """Names of links, joints and frames of this scope."""
        return {*self.links, *self.joints, *self.frames}

    @cached_property
    def canonical_link(self) -> str | None:
        """Link that moves with the model's own frame.

        It is the link that the model names, else its first link, else that of its first nested
        model.
        """
        given = self.element.attributes.get("canonical_link")
        if given and self.find_frame(given) is not None:
            return self.find_frame(given)
        for name in [*self._order, *self.models]:
            if name in self.links:
                return name
            inner = self.models[name]
            if inner.canonical_link is not None:
                return f"{name}::{inner.canonical_link}"
        return None


NAMED = "every model, link, joint and frame needs a name of its own"
DRAKE = (
    "drake:joint",
    "drake:ball_constraint",
    "drake:distance_constraint",
    "drake:collision_filter_group",
)
"""Elements of Drake in a model that are read, or change no motion."""
