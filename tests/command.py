"""The command, run in this process, and files that it reads."""

from __future__ import annotations

import functools
import json
from pathlib import Path

import typer.testing

from kempe.cli import app

typer.testing._get_command = functools.cache(typer.main.get_command)
"""The command is made of its functions once: that takes longer than most of what it is tested
with."""


class Result:
    """What one run of the command printed, and its exit code."""

    def __init__(self, *arguments: object):
        done = typer.testing.CliRunner().invoke(app, [str(a) for a in arguments])
        self.code = done.exit_code
        self.out = done.stdout
        self.err = done.stderr
        assert done.exception is None or isinstance(done.exception, SystemExit), done.exception

    def json(self) -> dict:
        """The output, which has to be JSON: without NaN and infinities."""

        def refuse(name: str) -> None:
            raise AssertionError(f"{name} is not JSON")

        return json.loads(self.out, parse_constant=refuse)


ARM = """\
<robot name="arm">
  <link name="base"/> <link name="upper"/> <link name="lower"/> <link name="tip"/> <link name="finger"/>
  <joint name="shoulder" type="revolute">
    <parent link="base"/> <child link="upper"/> <axis xyz="0 0 1"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/>
  </joint>
  <joint name="elbow" type="revolute">
    <parent link="upper"/> <child link="lower"/> <origin xyz="1 0 0"/> <axis xyz="0 0 1"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/>
  </joint>
  <joint name="end" type="fixed"> <parent link="lower"/> <child link="tip"/> <origin xyz="0.5 0 0"/> </joint>
  <joint name="slide" type="prismatic">
    <parent link="tip"/> <child link="finger"/> <axis xyz="1 0 0"/>
    <limit lower="0" upper="0.1" effort="1" velocity="1"/> <mimic joint="elbow" multiplier="0.01"/>
  </joint>
</robot>
"""

BROKEN = """\
<robot name="broken">
  <link name="base"/>
  <link name="hand"/>
  <joint name="wrist" type="revolute">
    <parent link="base"/> <child link="hand"/> <axis xyz="0 0 0"/>
    <limit lower="2" upper="1" effort="1" velocity="1"/>
  </joint>
</robot>
"""

FOUR_BAR = """\
# A four-bar linkage.
format = 1
name = "four-bar"
dim = 2
body = [{name = "crank"}, {name = "coupler"}, {name = "rocker"}]
frame = [{name = "pen", body = "crank", at = [1.0, 0.0]}]
postures = {home = {A = 0.5}}
joint = [
  {name = "A", type = "revolute", parent = "ground", child = "crank"},
  {name = "B", type = "revolute", parent = "crank", child = "coupler", at = [1, 0]},
  {name = "C", type = "revolute", parent = "coupler", child = "rocker", at = [2, 0], child_at = [1, 0]},
  {name = "D", type = "revolute", parent = "ground", child = "rocker", at = [2, 0]},
]
"""

ENGINE = """\
# A crank of 1 m and a rod of 2 m that push a slider along x; a wheel is geared to the crank.
format = 1
name = "engine"
dim = 2
body = [{name = "wheel"}, {name = "crank"}, {name = "rod"}, {name = "slider"}]
frame = [{name = "pin", body = "rod"}]
postures = {closed = {A = 0, B = 0, C = 0, S = 3}}
coupling = [{of = "W", sources = {A = -2.0}, offset = 0.1}]
joint = [
  {name = "W", type = "revolute", parent = "ground", child = "wheel", at = [-1, 0]},
  {name = "A", type = "revolute", parent = "ground", child = "crank"},
  {name = "B", type = "revolute", parent = "crank", child = "rod", at = [1, 0]},
  {name = "C", type = "revolute", parent = "rod", child = "slider", at = [2, 0]},
  {name = "S", type = "prismatic", parent = "ground", child = "slider", axis = [1, 0]},
]
"""

RODDED = """\
# The same engine with a rod that has no body, and a slider that floats on a line.
format = 1
name = "rodded"
dim = 2
body = [{name = "crank"}, {name = "slider"}]
joint = [
  {name = "A", type = "revolute", parent = "ground", child = "crank"},
  {name = "P", type = "planar", parent = "ground", child = "slider"},
]
constraint = [
  {name = "rod", type = "distance", parent = "crank", child = "slider", at = [1, 0], length = 2.0},
  {name = "guide", type = "point_on_line", parent = "ground", child = "slider", axis = [1, 0]},
]
"""

LIMITED = """\
format = 1
name = "limited"
dim = 2
body = [{name = "upper"}, {name = "lower"}]
frame = [{name = "tip", body = "lower", at = [0.4, 0]}]
joint = [
  {name = "shoulder", type = "revolute", parent = "ground", child = "upper"},
  {name = "elbow", type = "revolute", parent = "upper", child = "lower", at = [0.5, 0], limits = [0, 3]},
]
"""


def write_models(folder: Path) -> None:
    """Write the models above into a folder."""
    (folder / "arm.urdf").write_text(ARM)
    (folder / "broken.urdf").write_text(BROKEN)
    (folder / "fourbar.toml").write_text(FOUR_BAR)
    (folder / "engine.toml").write_text(ENGINE)
    (folder / "rodded.toml").write_text(RODDED)
    (folder / "limited.toml").write_text(LIMITED)
