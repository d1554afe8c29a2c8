import mujoco
import numpy as np
import pytest

from armctl.simulation import Simulation

PENDULUM = """
<mujoco>
  <worldbody><body><joint name="hinge" axis="0 1 0"/><geom size="0.1" pos="0.5 0 0"/></body></worldbody>
  <actuator><motor joint="hinge"/></actuator>
  <keyframe><key qpos="0.3"/></keyframe>
</mujoco>
"""


def pendulums(n=3):
    made = Simulation(mujoco.MjModel.from_xml_string(PENDULUM), n, threads=1)
    made.reset()
    made.refresh()
    return made


@pytest.mark.parametrize("velocity", [np.nan, np.inf, -1e200, 1e11])
def test_a_world_with_bad_numbers_stands_still_in_its_last_good_state(velocity):
    broken, whole = pendulums(), pendulums()
    for simulation in (broken, whole):
        simulation.step(10)
    last = broken.array("qpos")[1].copy()
    broken.array("qvel")[1] = velocity
    for _ in range(3):
        broken.step(5)
        whole.step(5)
        assert broken.unstable.tolist() == [False, True, False]
        assert np.array_equal(broken.array("qpos")[1], last)
    for field in ("qpos", "qvel", "time", "xpos"):
        assert np.array_equal(broken.array(field)[[0, 2]], whole.array(field)[[0, 2]])
        assert np.isfinite(broken.array(field)).all()


def test_a_force_that_explodes_in_the_middle_of_a_step_is_seen():
    simulation = pendulums()
    simulation.array("qfrc_applied")[2] = 1e300
    simulation.step(1, np.array([0, 2], dtype=np.int32))
    assert simulation.unstable.tolist() == [False, False, True]
    assert simulation.array("time").tolist() == [0.002, 0.0, 0.0]


def test_a_reset_makes_it_as_new():
    used, fresh = pendulums(), pendulums()
    used.array("qvel")[0] = np.nan
    used.step(4)
    used.reset(np.array([0], dtype=np.int32))
    used.refresh(np.array([0], dtype=np.int32))
    assert not used.unstable.any()
    for simulation in (used, fresh):
        simulation.step(20, np.array([0], dtype=np.int32))
    assert not used.unstable.any()
    assert np.array_equal(used.array("qpos")[0], fresh.array("qpos")[0])


def test_no_log_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    simulation = pendulums()
    simulation.array("qvel")[:] = np.nan
    simulation.step(1)
    assert simulation.unstable.all()
    assert not list(tmp_path.iterdir())
