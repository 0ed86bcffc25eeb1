"""Questions that cannot be posed: each is refused in one sentence, with exit code 2, and writes nothing."""

from __future__ import annotations

import shlex

import numpy as np
import pytest
from command import Result, write_models

pytest.importorskip("zarr", reason="zarr is not installed (extra scale)")

USAGE = """
fly -> (see 'kempe --help')
info -> (see 'kempe info --help')
fk x --fly -> (see 'kempe fk --help')
ik two_link -> (see 'kempe ik --help')
ik two_link --frame -> (see 'kempe ik --help')
dof -> FILE
plan two_link -> --frame
plot four_bar -> OUT
ik panda --frame tool -> '--target'
ik panda -> '--frame'
path panda --frame tool -> '--target'
ik arm.urdf --frame tip --target 1,0,0 --rng x -> --rng
workspace two_link --frame e --samples x -> --samples
map fk two_link p.csv -> --out
"""
MODELS = """
info arm.urdf --base fixed -> 'free'
dof four_bra -> did you mean 'four_bar'
spaces nothing_here -> nothing_here
library no_such_model -> no_such_model
convert arm.urdf arm.txt -> .urdf, .toml
convert arm.urdf no/arm.toml -> No such file
view two_link --html page.html --frame nope -> has no frame 'nope'
tour --section 1 --pictures p.csv -> this is no folder
"""
CONFIGURATIONS = """
fk arm.urdf --frame tipp -> arm has no frame 'tipp'; did you mean 'tip'?
fk arm.urdf --q 1 -> arm needs 2: shoulder, elbow
fk arm.urdf --q 1,2,3 -> arm needs 2
fk arm.urdf --q 1,a -> 'a' is not a number
fk arm.urdf --q 1,inf -> 'elbow'
fk arm.urdf --q elbw=1 -> did you mean 'elbow'
fk arm.urdf --q elbow=1,slide=1 -> 'slide'
fk arm.urdf --q elbow=1,2 -> name=value
fk arm.urdf --q elbow=1,elbow=2 -> twice
fk arm.urdf --q elbow= -> not a number
fk arm.urdf --q nothing.csv -> no such file
fk arm.urdf --q nothing.npy -> no such file
fk arm.urdf --q '' -> not a number
fk arm.urdf --out X.txt -> .csv or .npy
fk fourbar.toml --posture hom -> did you mean 'home'
fk slider_crank --q S=99 -> must close them
fk arm.urdf --q text.npy -> text.npy
fk arm.urdf --q flat.npy -> arm needs 2
fk arm.urdf --q object.npy -> object.npy
dof four_bar --actuated X -> no joint or coordinate 'X'
dof four_bar --actuated ' , ' -> names no joint; there are: A, B, C, D
dof four_bar --q A=nan -> 'A' is nan; it must be finite
dof four_bar --q 1,2 -> four_bar needs 4
dof four_bar --q coupler_point=1 -> no coordinate 'coupler_point'
dof four_bar --posture closd -> did you mean 'closed'
plot engine.toml w.png --q A=nan -> 'A' is nan
plot four_bar x.png --frame X -> no frame 'X'
plot four_bar x.bmp -> .png, .svg or .pdf
"""
TARGETS = """
ik arm.urdf --frame tipp --target 1,0,0 -> arm has no frame 'tipp'; did you mean 'tip'?
ik arm.urdf --frame tip --target 1,2 -> 2 numbers
ik arm.urdf --frame tip --target 1,2,3,4 -> 4 numbers
ik arm.urdf --frame tip --target 1,2,x -> 'x'
ik arm.urdf --frame tip --target 1,2,nan -> finite
ik arm.urdf --frame tip --target 1,0,0 --tolerance 0 -> positive
ik arm.urdf --frame tip --target 1,0,0 --tolerance 1,2,3 -> one or two
ik arm.urdf --frame tip --target 1,0,0 --tolerance= -> tolerance: '' is not a number
ik arm.urdf --frame tip --target 1,0,0 --seed 1 -> needs 2
ik arm.urdf --frame tip --target 1,0,0 --out q.txt -> .csv
ik two_link --frame e --target 0.5,0.3 --hold q1=0 -> add --all
ik two_link --frame e --target 0.5,0.3 --axis 0,0,1 -> --axis is for the tasks direction and position_axis
ik two_link --frame e --target 0.5,0.3,1 --all --axis 0,0,1 -> --axis is for
ik two_link --frame e --target 0.5,0.3 --all --rng 1 -> leave --all out
ik two_link --frame e --target 0.5,0.3 --all --task positions -> 'positions'
ik two_link --frame e --target 0.5,0.3 --all --task pose -> task 'pose' asks for an orientation
ik two_link --frame e --target 0.5,0.3 --all --hold q3=0 -> 'q3'
ik two_link --frame e --target 0.5,0.3 --all --hold q1 -> name=value
ik two_link --frame e --target 0.5,0.3 --all --hold q1=x -> 'x'
ik two_link --frame e --target 0.5,0.3 --all --tolerance 1e-6,1e-3 -> must be a positive number
ik two_link --frame e --target 0.5,0.3 --all --tolerance -1 -> must be a positive number
ik so101 --frame tool --target 0.2,0,0.1,0,0,0 --all --task direction --axis 1,2 -> it must be three numbers
ik so101 --frame tool --target 0.2,0,0.1,0,0,0 --all --task direction --axis 0,0,0 -> not all zero
ik panda --tasks t.toml --frame tool -> leave --frame out
ik panda --tasks t.toml --all -> --all
ik panda --tasks t.toml --prefer most -> 'most'
ik panda --tasks no.toml -> no such file
ik panda --frame tool --target 1,0,0 --prefer mid -> --prefer needs --tasks
path panda --frame tool --targets 0.4,0,0.5 -> .csv or .npy
path two_link --frame e --targets p.csv --max-step -1 -> max_step
path two_link --frame e --targets p.csv --tasks x -> leave --frame out
plan two_link --frame f -> 'f'
plan two_link --frame e --task x -> 'x'
plan two_link --frame e --hold q9 -> 'q9'
plan five_bar --frame tip -> loop
"""
LOOPS = """
assemble four_bar A -> 'A' is no known value
assemble four_bar =1 -> '=1' is no known value
assemble four_bar A= -> '' is not a number
assemble four_bar A=x -> 'x' is not a number
assemble four_bar A=-inf -> 'A' is -inf; it must be finite
assemble four_bar A=1 A=1 -> 'A' is given twice
assemble four_bar A=1,2 -> 'A' has 2 values
assemble four_bar crnk=1 -> no coordinate or frame 'crnk'
assemble four_bar coupler_point=1 -> its place is coupler_point=x,y
assemble four_bar coupler_point=1,nan -> is nan; it must be finite
assemble four_bar nothing.csv -> no such file
assemble four_bar --near opne -> no posture 'opne'
assemble four_bar --near A=inf -> is inf; it must be finite
assemble four_bar --near 1,2 -> four_bar needs 4
assemble four_bar A=1 --branch ++ -> branch is '++'; it must be 1 sign
assemble four_bar A=1 --branch open -> or the name of a posture
assemble four_bar coupler_point=0,1 --branch + -> 'coupler_point' is a frame
assemble four_bar --modes --branch + -> leave --branch
assemble four_bar A=0.3 --time-limit 1 -> --time-limit is for --modes
assemble engine.toml A=1 W=1 -> 'W' is 1; it follows 'A'
assemble four_bar unnamed.csv -> must name
assemble four_bar unknown.csv -> no coordinate or frame 'X'
assemble four_bar twice.csv -> twice
assemble four_bar A.csv --plot x.png -> a picture shows one configuration
assemble four_bar A.csv -o A.csv -> the command reads this file
classify four_bar --q 0.5,0.1,0.2,0.3 -> --project
trace four_bar --driver X -> 'X'
trace four_bar --frame X -> no frame 'X'
trace four_bar --points 1 -> --points is 1; it must be at least 2
trace four_bar --hold A -> 'A' is no known value: write name=value
trace four_bar --hold A=1 --start A=1 -> leave one out
trace four_bar --start opne -> no posture 'opne'
trace four_bar --time-limit 0 -> time_limit is 0
trace five_bar -> 2 freedoms
trace two_link -> 2 freedoms
spaces two_link -o q.csv -> --sample
spaces two_link --plot p.png -> --frame
spaces two_link --position-only -> --frame
spaces two_link --frame nowhere -> nowhere
spaces two_link --sample 0 -> n is 0
spaces slider --sample 5 -> not bounded
spaces puma560 --frame tool --plot p.png -> two degrees of freedom
spaces two_link --frame e --plot p.gif -> .png
"""
MAPS = """
workspace two_link --frame e -n 0 -> n is 0
workspace two_link --frame e -n 1e30 -> n is 1e+30
workspace two_link --frame ground -> does not move
workspace two_link --frame hand -> hand
workspace joint_prismatic --frame body -> no limits
workspace two_link --frame e --box 1,2,3 -> --box
workspace two_link --frame e --box -inf,inf,0,1 -> --box is '-inf,inf,0,1', which holds -inf
workspace two_link --frame e --cells x -> --cells
workspace two_link --frame e --cells 1e400 -> --cells is '1e400', which holds inf
workspace two_link --frame e --threads 99999999999999999999 -> at most 4096
workspace two_link --frame e --plot map.txt -> pictures are .png, .svg or .pdf files
workspace two_link --frame e --kind some -> no kind 'some'; there are: 'reachable'
workspace two_link --frame e --kind orientation -> needs at
workspace two_link --frame e --at 1 -> one place (2,)
workspace two_link --frame e --orientation a -> --orientation
query nowhere.zarr 1,2 -> no such map
map fk two_link none.npy -o o.zarr -> no such file
map turn two_link p.csv -o o.zarr -> no verb 'turn'
map ik two_link p.csv -o o.zarr -> ik needs a frame
map ik two_link p.csv -o o.zarr --frame e --form 3x4 -> no option of map ik 'form'
map ik two_link p.csv -o o.zarr --frame e --task foo -> task is 'foo'; it must be one of
map ik two_link p.csv -o o.zarr --frame e --start nan,0 -> start is [nan, 0.0]
map assemble four_bar p.csv -o o.zarr --tolerance 1,2 -> it is one number
map fk two_link p.csv -o o.zarr -> no coordinate 'x'
map fk two_link archive.npy --frame e -o o.zarr -> this is a .npz archive
fk two_link --q archive.npy -> this is a .npz archive of arrays
fk two_link --q promises.npy -> cannot be read as .npy: mmap length
fk two_link --q q.npy -o q.npy -> the command reads this file
ik two_link --frame e --target p.csv -o p.csv -> the command reads this file
path two_link --frame e --targets p.csv -o p.csv -> the command reads this file
reach two_link p.csv --frame e -o p.csv -> the command reads this file
reach ur5 0.4,0.1,0.5 --frame tool -> POSES
reach ur5 none.csv --frame tool -> no such file
reach two_link p.csv --frame hand -> hand
place two_link p.csv --frame e --box x -> it must be NAME=VALUE
place two_link p.csv --frame e --box x=a,b -> is not a number
place two_link p.csv --frame e --box x=0,1 --box x=0,2 -> --box gives 'x' twice
place two_link p.csv --frame e --box w=0,1 -> w
place two_link p.csv --frame e --box x=0,1 --cells 0 -> cells
singularities two_link --frame e --starts 100000000 -> starts is 100000000
singularities two_link --frame e --plot singular.xyz -> .xyz
"""
ROWS = [
    row
    for table in (USAGE, MODELS, CONFIGURATIONS, TARGETS, LOOPS, MAPS)
    for row in table.strip().splitlines()
]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder of models, and of files of rows: good ones, and such as are not what their names say."""
    monkeypatch.chdir(tmp_path)
    write_models(tmp_path)
    texts = {
        "p.csv": "x,y\n0.6,0.3\n0.5,0.2\n",
        "A.csv": "A\n0.1\n0.2\n",
        "unnamed.csv": "1\n2\n",
        "unknown.csv": "X\n1\n",
        "twice.csv": "A,A\n1,1\n",
        "text.npy": "no array",
        "t.toml": '[[task]]\ntype = "posture"\nq = {panda_joint1 = 0.3}\n',
    }
    for name, text in texts.items():
        (tmp_path / name).write_text(text)
    np.save("q.npy", np.zeros((3, 2)))
    np.save("flat.npy", np.zeros(2))
    np.save("object.npy", np.array([{}], dtype=object), allow_pickle=True)
    with open("archive.npy", "wb") as file:
        np.savez(file, q=np.zeros((3, 2)))
    head = b"{'descr': '<f8', 'fortran_order': False, 'shape': (999999999999, 2), }"
    data = b"\x93NUMPY\x01\x00v\x00" + head.ljust(117) + b"\n"
    (tmp_path / "promises.npy").write_bytes(data)
    return tmp_path


@pytest.mark.parametrize("row", ROWS)
def test_wrong_questions_are_refused_in_a_sentence(row: str, folder):
    words, said = row.split(" -> ")
    before = {path: path.read_bytes() for path in folder.iterdir()}
    plain = Result(*shlex.split(words))
    data = Result(*shlex.split(words), "--json")
    assert plain.code == data.code == 2 and plain.out == data.err == "", plain.out + data.err
    assert plain.err.startswith("error: ") and plain.err.count("\n") == 1, plain.err
    assert said in plain.err and data.json()["error"], plain.err
    assert {path: path.read_bytes() for path in folder.iterdir()} == before
