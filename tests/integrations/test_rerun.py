"""A recording for Rerun, opened by Rerun's own reader, holds the episodes that were played."""

import sys
from typing import Any

import numpy as np
import pytest
from rerun.chunk import RrdReader

from armctl.core.errors import ConfigurationError, ResultsError
from armctl.episodes.failures import PolicyFailed
from armctl.integrations.rerun import rerun_opener
from armctl.viewer.stage import Stage
from armctl.viewer.terminal import Outputs, run_episodes

from ..command_line import full_disk

ARM, BRIDGE = "armctl/ArmReachObstacles-v0", "armctl/BridgeCrossMoving-v0"
STEPS = 8


def record(file, policy, env, episodes=1, steps=STEPS, **options):
    outputs = Outputs(log=rerun_opener(file))
    return run_episodes(policy, env, range(episodes), 2, steps=steps, env_options=options, outputs=outputs)


class Recording:
    """Values by entity, component and control step."""

    def __init__(self, file):
        self._rows, self.times, self.static = {}, {}, {}
        for chunk in RrdReader(file).stream().to_chunks():
            batch = chunk.to_record_batch()
            for name in batch.schema.names:
                values = batch[name].to_pylist()
                if chunk.is_static:
                    self.static[chunk.entity_path, name] = values[-1]
                elif "step" in batch.schema.names:
                    steps = batch["step"].to_pylist()
                    self._rows.setdefault((chunk.entity_path, name), {}).update(zip(steps, values, strict=True))
                    self.times.update(zip(steps, batch["time"].to_pylist(), strict=True))
        self.entities = {path for path, _ in self._rows}

    def of(self, path, component):
        """The values of the steps at which there are any."""
        rows = self._rows[path, component]
        return {step: np.array(rows[step]) for step in sorted(rows) if rows[step] is not None}


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    file = tmp_path_factory.mktemp("arm") / "arm.rrd"
    assert record(file, "reach_ompl", ARM, episodes=2)
    return Recording(file)


@pytest.fixture(scope="module")
def bridge(tmp_path_factory):
    file = tmp_path_factory.mktemp("bridge") / "bridge.rrd"
    assert record(file, "random", BRIDGE)
    return Recording(file)


def test_joints_bodies_and_rewards_are_those_of_the_episodes(arm):
    joints, target = arm.of("/joints", "Scalars:scalars"), arm.of("/world/target", "Transform3D:translation")
    link = arm.of("/world/arm.wrist_3_link", "Transform3D:translation")
    rewards, total = arm.of("/reward", "Scalars:scalars"), arm.of("/return", "Scalars:scalars")
    stage = Stage("reach_ompl", ARM, seed=2)
    for episode in range(2):
        stage.play("reach_ompl", 2, episode)
        for step in range(STEPS + 1):
            moment = episode * (STEPS + 1) + step
            np.testing.assert_array_equal(joints[moment], stage.task.motion().configuration[0])
            body = stage.task.simulation.data(0).body("arm/wrist_3_link").xpos
            np.testing.assert_allclose(link[moment][0], body, atol=1e-6)
            if step == 0:
                np.testing.assert_allclose(target[moment][0], stage.task.state.target_position[0], atol=1e-6)
            if step < STEPS:
                stage.step()
                assert total[moment] == pytest.approx(stage.status.total_reward)
                assert rewards[moment].sum() == pytest.approx(total[moment] - (total[moment - 1] if step else 0))


def test_time_is_the_simulation_s(arm):
    assert sorted(arm.times) == list(range(2 * (STEPS + 1)))
    assert [time.total_seconds() for _, time in sorted(arm.times.items())] == pytest.approx(
        0.04 * np.arange(2 * (STEPS + 1))
    )


def test_the_plan_leads_to_the_target_and_ends_with_the_episode(arm):
    path = arm.of("/world/plans/path", "LineStrips3D:strips")
    assert set(path) == {*range(STEPS), *range(STEPS + 1, 2 * STEPS + 1)}
    target = arm.of("/world/target", "Transform3D:translation")
    for moment in (0, STEPS + 1):
        assert np.linalg.norm(path[moment][0][-1] - target[moment][0]) < 0.05
    assert set(arm.of("/world/plans/path", "Clear:is_recursive")) == {STEPS, 2 * STEPS + 1}


def test_series_have_names_and_shapes_their_kinds(arm, bridge):
    assert arm.static["/joints", "SeriesLines:names"][0] == "shoulder_pan_joint"
    assert len(arm.static["/reward", "SeriesLines:names"]) == len(arm.of("/reward", "Scalars:scalars")[0])
    for recording, path, component in (
        (arm, "/world/target/target", "Ellipsoids3D:half_sizes"),
        (arm, "/world/box_0/box_0", "Boxes3D:half_sizes"),
        (bridge, "/world/rover.front_left_wheel/rover.front_left_wheel", "Cylinders3D:lengths"),
    ):
        assert recording.of(path, component)
    meshes = [path for path in arm.entities if (path, "Mesh3D:vertex_positions") in arm._rows]
    assert len(meshes) == 7


def test_contacts_bear_the_rover(bridge):
    """At rest, the floor pushes with the rover's weight."""
    model = Stage("random", BRIDGE, seed=2).task.simulation.model
    rover = model.body_rootid == model.body_rootid[model.body("rover/base").id]
    weight = 9.81 * model.body_mass[rover].sum()
    forces = bridge.of("/world/contacts/forces", "Arrows3D:vectors")
    assert 0.3 * weight < forces[STEPS].reshape(-1, 3)[:, 2].sum() / 2e-3 < 3 * weight
    assert len(bridge.of("/world/contacts", "Points3D:positions")[STEPS]) == len(forces[STEPS])


def test_the_camera_is_what_the_policy_saw(bridge):
    depths = bridge.of("/camera/image", "DepthImage:buffer")
    stage: Any = Stage("random", BRIDGE, seed=2)
    for step in range(3):
        seen = depths[step].astype(np.uint8).tobytes()
        np.testing.assert_array_equal(np.frombuffer(seen, np.float32), stage.observations["image"].ravel())
        stage.step()


def test_pedestrians_move(bridge):
    assert len(bridge.of("/world/walker_0", "Transform3D:translation")) == STEPS + 1


def test_environments_of_others_have_what_they_tell(tmp_path):
    assert record(tmp_path / "p.rrd", "random", "Pendulum-v1")
    found = Recording(tmp_path / "p.rrd")
    assert len(found.of("/action", "Scalars:scalars")) == STEPS
    assert len(found.of("/observation/observation", "Scalars:scalars")) == STEPS + 1
    rewards, total = (found.of(path, "Scalars:scalars") for path in ("/reward", "/return"))
    assert sum(rewards.values()) == pytest.approx(total[STEPS - 1])
    assert total[STEPS - 1] < 0
    assert not any(path.startswith("/world") for path in found.entities)


INTERRUPTED = """
def policy(observation):
    policy.calls = getattr(policy, "calls", 0) + 1
    if policy.calls == 4:
        raise {error}
    return [0.0]
"""


@pytest.mark.parametrize("error", ["KeyboardInterrupt", "ValueError"])
def test_what_was_played_before_an_interrupt_or_a_failure_is_there(tmp_path, monkeypatch, error):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text(INTERRUPTED.format(error=error))
    if error == "KeyboardInterrupt":
        assert not record(tmp_path / "p.rrd", "mine.py:policy", "Pendulum-v1")
    else:
        with pytest.raises(PolicyFailed):
            record(tmp_path / "p.rrd", "mine.py:policy", "Pendulum-v1")
    assert len(Recording(tmp_path / "p.rrd").of("/action", "Scalars:scalars")) == 3


def test_a_file_that_cannot_be_written_is_told_before_anything_is_played(tmp_path):
    with pytest.raises(ConfigurationError, match=r"name ends in \.rrd; .*film\.mp4' does not"):
        record(tmp_path / "film.mp4", "random", ARM)
    (tmp_path / "file").touch()
    with pytest.raises(ResultsError, match="there is no folder"):
        record(tmp_path / "file/run.rrd", "random", ARM)


def test_a_full_disk_leaves_the_older_recording(tmp_path):
    (tmp_path / "p.rrd").write_text("older")
    with full_disk(2_000), pytest.raises(ResultsError, match=r"p\.rrd cannot be written: File too large"):
        record(tmp_path / "p.rrd", "random", "Pendulum-v1")
    assert [(one.name, one.read_text()) for one in tmp_path.iterdir()] == [("p.rrd", "older")]


def test_a_missing_extra_is_named_in_a_line(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(ConfigurationError, match=r"^--rerun needs rerun: pip install '.*\[rerun\]'"):
        record(tmp_path / "p.rrd", "random", ARM)
