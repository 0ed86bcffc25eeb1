"""Small SDF files, each for some rules of the format. As a program it records what Drake makes of
them in `sdf_drake.json`, where Drake is installed: ``python tests/description/sdf_files.py``.
"""

from __future__ import annotations

import json
import tempfile
from importlib import import_module
from pathlib import Path
from typing import Any

RECORD = Path(__file__).with_name("sdf_drake.json")
"""For each file the coordinates of all joints, and the poses of bodies and frames with them."""


def joint(
    name: str,
    parent: str,
    child: str,
    inside: str = "<axis><xyz>0 0 1</xyz></axis>",
    kind: str = "revolute",
) -> str:
    """A <joint>."""
    ends = f"<parent>{parent}</parent><child>{child}</child>"
    return f'<joint name="{name}" type="{kind}">{ends}{inside}</joint>\n'


def link(name: str, pose: str = "", relative: str = "") -> str:
    """A <link> with a mass."""
    of = f' relative_to="{relative}"' if relative else ""
    placed = f"<pose{of}>{pose}</pose>" if pose or relative else ""
    return f'<link name="{name}">{placed}<inertial><mass>1</mass></inertial></link>\n'


def sdf(inside: str, version: str = "1.12") -> str:
    """A file."""
    return f'<?xml version="1.0"?>\n<sdf version="{version}">\n{inside}</sdf>\n'


def model(inside: str, version: str = "1.12", name: str = "m", attributes: str = "") -> str:
    """A file with one model."""
    return sdf(f'<model name="{name}"{attributes}>\n{inside}</model>\n', version)


def world(inside: str, version: str = "1.12") -> str:
    """A file with a world."""
    return sdf(f'<world name="w">\n{inside}</world>\n', version)


TURNED = "<pose>0.1 0.2 0.3 0.4 -0.5 0.6</pose>"
CONFIG = '<model><name>x</name><sdf version="1.4">old.sdf</sdf><sdf version="1.10">model.sdf</sdf></model>'
ARM = model(
    link("base", "0.1 0 0.2 0 0 0.3")
    + link("tip", "0 0.4 0.1 0.5 0 0")
    + '<frame name="grip" attached_to="tip"><pose>0 0 0.2 0 1 0</pose></frame>\n'
    + joint("turn", "base", "tip", "<axis><xyz>0.6 0 0.8</xyz></axis>"),
    name="arm",
)

FILES: dict[str, dict[str, str]] = {
    "frames": {
        "main.sdf": model(
            "<pose>1 2 3 0.1 0.2 0.3</pose>\n"
            + link("a", "0.1 0.2 0.3 0.3 -0.2 0.1")
            + link("b", "0.5 0 0 0 0.7 0", "j")
            + link("c", "0 0.1 0.2 -0.4 0 0.2", "f")
            + '<frame name="f" attached_to="b"><pose>0 0 0.3 1.1 0 0</pose></frame>\n'
            + '<frame name="g" attached_to="f"><pose relative_to="a">0 0.3 0 0 1.2 0</pose></frame>\n'
            + '<frame name="h"><pose degrees="true">0 0.3 0 30 45 -60</pose></frame>\n'
            + joint(
                "j",
                "a",
                "b",
                '<pose relative_to="a">0.2 0 0.1 0 0 0.5</pose>'
                '<axis><xyz expressed_in="h">0.6 0.8 0</xyz></axis>',
            )
            + joint(
                "k",
                "f",
                "c",
                '<pose>0 0 -0.2 0.3 0 0</pose><axis><xyz expressed_in="__model__">0 1 1</xyz></axis>',
                "prismatic",
            )
        )
    },
    "quaternions": {
        "main.sdf": model(
            '<link name="a"><pose rotation_format="quat_xyzw">1 2 3  0.1 0.2 0.3 0.9</pose></link>\n'
            '<link name="b"><pose rotation_format="euler_rpy" degrees="1">0 0 1 90 0 45</pose></link>\n'
            + joint("j", "a", "b"),
            "1.9",
        )
    },
    "version_1_3": {
        "main.sdf": model(
            link("a", "1 0 0 0.3 0.4 0.5")
            + link("b", "0 1 0 0.7 0 0")
            + joint("j", "a", "b", TURNED + "<axis><xyz>1 2 3</xyz></axis>"),
            "1.3",
        )
    },
    "version_1_4": {
        "main.sdf": model(
            "<pose>0 0 1 0.2 0 0</pose>"
            + link("a", "1 0 0 0.3 0.4 0.5")
            + link("b", "0 1 0 0.7 0 0")
            + joint("j", "a", "b", TURNED + "<axis><xyz>1 2 3</xyz></axis>"),
            "1.4",
        )
    },
    "version_1_5": {
        "main.sdf": model(
            link("a", "1 0 0 0.3 0.4 0.5")
            + link("b", "0 1 0 0.7 0 0")
            + link("c", "0 1 1 0 0.7 0")
            + joint("j", "a", "b", TURNED + "<axis><xyz>1 2 3</xyz></axis>")
            + joint(
                "k",
                "b",
                "c",
                TURNED
                + "<axis><xyz>1 2 3</xyz><use_parent_model_frame>1</use_parent_model_frame></axis>",
            ),
            "1.5",
        )
    },
    "version_1_6": {
        "main.sdf": model(
            link("a", "1 0 0 0.3 0.4 0.5")
            + '<link name="b"><pose frame="a">0 1 0 0.7 0 0</pose></link>'
            + '<frame name="f"><pose frame="b">0 1 0 0.7 0 0</pose></frame>'
            + joint("j", "world", "a")
            + joint(
                "k",
                "a",
                "b",
                "<axis><xyz>0 1 0</xyz><use_parent_model_frame>true</use_parent_model_frame></axis>",
            ),
            "1.6",
        )
    },
    "nested": {
        "main.sdf": model(
            link("base")
            + '<model name="inner" canonical_link="q" placement_frame="p">'
            + '<pose relative_to="base">0 0.5 0 0 0 1</pose>\n'
            + link("p", "0.1 0.2 0.3 0.3 0 0")
            + link("q", "0 0.2 0 0 0.4 0")
            + '<model name="core"><pose>0 0 0.4 0 1 0</pose>'
            + link("x", "0.1 0 0 0 0 1")
            + "</model>\n"
            + joint("i", "q", "p")
            + joint("d", "p", "core::x")
            + "</model>\n"
            + '<frame name="of_model" attached_to="inner"><pose>0 0.1 0 0 0 0</pose></frame>\n'
            + '<frame name="deep"><pose relative_to="inner::core::x">0 0.1 0 0 0 0</pose></frame>\n'
            + joint("j", "base", "inner", TURNED + "<axis><xyz>0 1 0</xyz></axis>"),
            "1.8",
        )
    },
    "include": {
        "main.sdf": world(
            '<include><uri>model://arm/</uri><name>left</name><pose degrees="true">0 1 0 0 0 90</pose>'
            "</include>\n"
            "<include><uri>model://arm/</uri><name>right</name></include>\n"
            "<include><uri>package://arm/model.sdf</uri><name>third</name>"
            '<pose relative_to="left::grip">0 0 1 0 0 0</pose><placement_frame>grip</placement_frame>'
            "</include>\n"
        ),
        "arm/model.config": CONFIG,
        "arm/model.sdf": ARM,
        "arm/old.sdf": "<sdf version='1.4'/>",
    },
    "merge": {
        "main.sdf": model(
            '<frame name="mount"><pose>0 0 0.5 0 0 1</pose></frame>\n'
            '<include merge="true"><uri>model://arm/</uri><pose relative_to="mount">0 1 0 0 0.3 0</pose>'
            "</include>\n"
            + link("tool", "0 0 0.1 0 0.2 0", "grip")
            + joint(
                "wrist", "tip", "tool", TURNED + '<axis><xyz expressed_in="base">0 1 0</xyz></axis>'
            ),
            "1.9",
        ),
        "arm/model.config": CONFIG,
        "arm/model.sdf": ARM,
    },
    "world": {
        "main.sdf": world(
            '<frame name="spot"><pose>3 0 0 0 0 0.5</pose></frame>\n'
            '<model name="table"><static>true</static><pose>0 0 0.5 0 0 0.2</pose>'
            + link("top", "0 0 0.1 0 0 0")
            + link("leg", "0.3 0 -0.2 0 0 0")
            + '</model>\n<model name="arm"><pose relative_to="spot">0 1 0 0 0 0.1</pose>'
            + link("a", "0 0 1 0 0.4 0")
            + link("b", "0 0 2 0 0 0")
            + joint("j", "a", "b", TURNED + "<axis><xyz>0 1 0</xyz></axis>")
            + '</model>\n<model name="box"><pose>5 5 0 0 0 0</pose>'
            + link("box")
            + "</model>\n"
            + joint("held", "table::top", "arm::a", "", "fixed")
        )
    },
    "types": {
        "main.sdf": model(
            "".join(link(f"l{i}", f"0 {i} 0 0.{i} 0 0.2") for i in range(8))
            + joint("weld", "world", "l0", TURNED, "fixed")
            + joint("slide", "l0", "l1", TURNED + "<axis><xyz>0 1 1</xyz></axis>", "prismatic")
            + joint("spin", "l1", "l2", TURNED + "<axis><xyz>1 0 0</xyz></axis>", "continuous")
            + joint("ball", "l2", "l3", TURNED, "ball")
            + joint(
                "cardan",
                "l3",
                "l4",
                TURNED + "<axis><xyz>0 0.6 0.8</xyz></axis><axis2><xyz>1 0 0</xyz></axis2>",
                "universal",
            )
            + joint(
                "screw",
                "l4",
                "l5",
                TURNED
                + "<screw_thread_pitch>0.2</screw_thread_pitch><axis><xyz>0 1 0</xyz></axis>",
                "screw",
            )
            + joint(
                "old_screw",
                "l5",
                "l6",
                TURNED + "<thread_pitch>-20</thread_pitch><axis><xyz>0 1 0</xyz></axis>",
                "screw",
            )
            + joint("bare_screw", "l6", "l7", "<axis><xyz>0 1 0</xyz></axis>", "screw")
        )
    },
    "loop": {
        "main.sdf": model(
            link("ground")
            + link("crank", "0 0 0 0 0 1.2")
            + link("coupler", "0.5 0 0 0 0 -1", "crank")
            + link("rocker", "2 0 0 0 0 1.5")
            + joint("fix", "world", "ground", "", "fixed")
            + joint("a", "ground", "crank")
            + joint("b", "crank", "coupler")
            + joint("c", "ground", "rocker")
            + joint(
                "d",
                "rocker",
                "coupler",
                '<pose relative_to="rocker">0.8 0 0 0 0.3 0</pose>'
                '<axis><xyz expressed_in="ground">0 0 1</xyz></axis>',
            )
        )
    },
    "planar": {
        "main.sdf": model(
            link("a", "0 0 1 0 0.3 0")
            + link("b", "0 0 2 0.1 0 0")
            + '<frame name="f" attached_to="a"><pose>0 0.1 0 0 0 1</pose></frame>\n'
            + '<drake:joint name="j" type="planar"><drake:parent>f</drake:parent>'
            "<drake:child>b</drake:child><drake:damping>0 0 0</drake:damping></drake:joint>\n",
            "1.9",
        )
    },
}
"""The files of each case by their paths; main.sdf is read."""


def write(files: dict[str, str], folder: Path) -> Path:
    """The path of main.sdf, after writing the files into a folder."""
    for name, text in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return folder / "main.sdf"


def _drake(name: str) -> Any:
    """A module of Drake."""
    return import_module(f"pydrake.multibody.{name}")


def record(path: Path) -> dict[str, Any]:
    """What Drake makes of a file: coordinates of its joints, and poses in the world.

    A joint that closes a loop is taken out, and its frames on its two bodies are recorded.
    """
    import numpy as np

    parsing, plants, tree = (_drake(name) for name in ("parsing", "plant", "tree"))
    plant = plants.MultibodyPlant(0.001)
    parser = parsing.Parser(plant)
    for config in path.parent.glob("*/model.config"):
        parser.package_map().Add(config.parent.name, str(config.parent))
    parser.AddModels(str(path))

    def name(thing: Any) -> str:
        return f"{plant.GetModelInstanceName(thing.model_instance())}::{thing.name()}"

    def pose(X: Any) -> list[list[float]]:
        return X.GetAsMatrix4()[:3].tolist()

    out: dict[str, Any] = {"joints": {}, "bodies": {}, "frames": {}, "loops": {}}
    children: set[str] = set()
    for index in plant.GetJointIndices():
        j = plant.get_joint(index)
        if name(j.child_body()) in children:
            ends = (j.frame_on_parent(), j.frame_on_child())
            out["loops"][name(j)] = [pose(f.GetFixedPoseInBodyFrame()) for f in ends]
            out["loops"][name(j)].append(j.revolute_axis().tolist())
            for actuator in list(plant.GetJointActuatorIndices()):
                plant.RemoveJointActuator(plant.get_joint_actuator(actuator))
            plant.RemoveJoint(j)
        else:
            children.add(name(j.child_body()))
    plant.Finalize()
    context = plant.CreateDefaultContext()
    rng = np.random.default_rng(7)
    q = plant.GetPositions(context)
    for index in plant.GetJointIndices():
        j = plant.get_joint(index)
        if j.num_positions() and j.type_name() != "quaternion_floating":
            values = rng.uniform(-1, 1, int(j.num_positions())).tolist()
            start = j.position_start()
            q[start : start + len(values)] = values
            out["joints"][name(j)] = [j.type_name(), values]
    plant.SetPositions(context, q)
    for i in range(1, plant.num_bodies()):
        body = plant.get_body(tree.BodyIndex(i))
        out["bodies"][name(body)] = pose(plant.EvalBodyPoseInWorld(context, body))
    for i in range(plant.num_frames()):
        frame = plant.get_frame(tree.FrameIndex(i))
        own = not frame.name().endswith(("_parent", "_child", "_F", "_M", "__", "world"))
        if own and frame.name() and name(frame) not in out["bodies"]:
            out["frames"][name(frame)] = pose(frame.CalcPoseInWorld(context))
    return out


def main() -> None:
    """Write the record anew."""
    found: dict[str, Any] = {}
    for case, files in FILES.items():
        with tempfile.TemporaryDirectory() as folder:
            found[case] = record(write(files, Path(folder)))
    RECORD.write_text(json.dumps(found, separators=(",", ":")) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
