"""The forward model in other forms than whole poses."""

import pickle

import numpy as np
import pytest
from hunts import some
from scipy.spatial.transform import Rotation

import kempe
from kempe.errors import InputError, UnknownNameError

ARMS = {"panda": "hand", "ball": None, "four_bar": None, "two_link": None, "joint_free": None}
FORMS = {"matrix": 16, "3x4": 12, "position": 3, "position_quat_wxyz": 7}


def arm(name):
    system = kempe.load(name)
    return system, ARMS[name] if ARMS[name] in system.frame_names else system.body_names[-1]


def same(form, given, X):
    if form == "position_quat_wxyz":
        turned = Rotation.from_quat(given[..., 3:].reshape(-1, 4), scalar_first=True).as_matrix()
        assert np.abs(turned.reshape(*X.shape[:-2], 3, 3) - X[..., :3, :3]).max(initial=0.0) < 1e-6
        given = given[..., :3]
        form = "position"
    wanted = {"matrix": X, "3x4": X[..., :3, :], "position": X[..., :3, 3]}[form]
    assert given.shape == wanted.shape and np.abs(given - wanted).max(initial=0.0) < 1e-6


@pytest.mark.parametrize("dtype", [None, "float32"])
@pytest.mark.parametrize("shape", [(), (0,), (1,), (5, 3), (21000,)])
@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("name", some(ARMS, 3))
def test_forms_are_parts_of_the_pose(name, form, shape, dtype):
    system, frame = arm(name)
    q = system.random(0, shape)
    for wanted in (frame, [frame, frame], None):
        given = system.fk(q, wanted, form=form, dtype=dtype)
        same(form, given, system.fk(q, wanted))
        assert given.dtype == (dtype or np.float64)


def test_positions_are_exact():
    system, frame = arm("panda")
    q = system.random(1, 1000)
    assert (
        np.abs(system.fk(q, frame, form="position") - system.fk(q, frame)[:, :3, 3]).max()
        < 1e-15 * 8
    )


def test_out_is_filled():
    system, frame = arm("panda")
    q = system.random(1, 40)
    out = np.zeros((40, 3), dtype=np.float32)
    assert system.fk(q, frame, out, form="position", dtype=np.float32) is out
    assert np.abs(out - system.fk(q, frame)[:, :3, 3]).max() < 1e-6


def test_bad_rows_are_nan_and_a_bad_configuration_is_refused():
    system, frame = arm("panda")
    q = system.random(1, 40)
    q[7] = np.nan
    for form in FORMS:
        bad = np.isnan(system.fk(q, frame, form=form).reshape(40, -1))
        assert bad[7].sum() >= 3 and not np.delete(bad, 7, axis=0).any()
        with pytest.raises(InputError, match="finite"):
            system.fk(q[7], frame, form=form)


def test_wrong_forms_are_named():
    system, frame = arm("panda")
    with pytest.raises(UnknownNameError, match="position_quat_wxyz"):
        system.fk(system.mid, frame, form="quaternion")
    with pytest.raises(InputError, match="float32"):
        system.fk(system.mid, frame, form="3x4", dtype="int32")
    with pytest.raises(InputError, match=r"shape \(7,\)"):
        system.fk(system.mid, frame, np.empty(6), form="position_quat_wxyz")


@pytest.mark.parametrize("dtype", [None, "float32"])
@pytest.mark.parametrize("form", [None, *FORMS])
def test_queries_have_forms(form, dtype):
    system, frame = arm("panda")
    query = system.query(frame, form, dtype)
    q = system.random(1, 30)
    for part in (q, q[0], q[:0]):
        assert np.array_equal(query(part), system.fk(part, frame, form=form, dtype=dtype))
        assert np.array_equal(pickle.loads(pickle.dumps(query))(part), query(part))
    out = np.empty((30, *query(q[0]).shape), dtype=dtype)
    assert query(q, out) is out and np.array_equal(out, query(q))
    assert np.array_equal(query.jacobian(q), system.jacobian(q, frame))


def test_wrong_forms_of_queries_are_named_at_once():
    system, frame = arm("panda")
    with pytest.raises(UnknownNameError, match="position_quat_wxyz"):
        system.query(frame, "quaternion")
    with pytest.raises(InputError, match="float32"):
        system.query(frame, dtype=int)
    with pytest.raises(UnknownNameError, match="elbow"):
        system.query("elbow", "position")


def test_a_particle_has_the_unit_quaternion():
    m = kempe.Mechanism("rail")
    m.joint("x", "prismatic", m.ground, m.particle("bead"), axis="x")
    found = m.build().fk([[0.5], [1.0]], "bead", form="position_quat_wxyz")
    assert np.array_equal(found, [[0.5, 0, 0, 1, 0, 0, 0], [1.0, 0, 0, 1, 0, 0, 0]])
