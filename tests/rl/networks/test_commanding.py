from typing import Any

import numpy as np
import pytest
import torch

from armctl.agents import INPUT
from armctl.agents.graph import load_graph
from armctl.core.errors import ConfigurationError
from armctl.envs import make_worlds
from armctl.kinematics import ArmModel
from armctl.rl.algorithms.distil import DistillationBatch, DistilOptions, Student
from armctl.rl.data.demonstrations import teacher_in
from armctl.rl.networks.actor import tensors
from armctl.rl.networks.onnx_graph import initial_memory
from armctl.rl.run.training import Training
from armctl.tasks.reach.moving import TargetTrajectory
from armctl.training.learners import Recipe

MOVING, OBSTACLES, BRIDGE = "armctl/ArmReachMoving-v0", "armctl/ArmReachObstacles-v0", "armctl/BridgeCross-v0"
PERIOD = 0.04
SMALL: dict[str, Any] = {
    "steps": 16 * 8, "worlds": 16, "length": 8, "hidden_units": 16, "memory_units": 8, "mixed_steps": 64,
    "validation_episodes": 1, "evaluation_episodes": 1, "commanding": True,
}  # fmt: skip

PLAIN, ROBUST = SMALL | {"commanding": False}, {"features": "robust"}


def recipe(env=MOVING, teacher: str | None = "moving_dagger", **changes):
    fields: dict[str, Any] = {
        "env_options": {"max_episode_steps": 6},
        "training_options": {"disturbances": {"noise": (0, 0.05), "delay": (0, 2)}},
        "options": SMALL,
    }
    return Recipe(name="commanding", learner="distil", env=env, teacher=teacher, **fields | changes)


def student_of(chosen, out):
    training = Training(chosen, chosen.read_options(DistilOptions), out, 0, False)
    return Student(training, training.options)


@pytest.fixture
def student(tmp_path):
    return student_of(recipe(), tmp_path / "run")


def test_a_noisy_reading_of_the_joints_hardly_moves_the_command(student):
    """With actions relative to readings, as those of other students, it moves by all of the noise."""
    clear = torch.as_tensor(student.training.held_out.reset(seed=3)[0]).repeat(200, 1)
    noise = 0.05 * torch.randn(200, 6, generator=torch.Generator().manual_seed(0))
    noisy = torch.cat((clear[:, :3], clear[:, 3:9] + noise, clear[:, 9:]), dim=1)
    first, second = (student.actor(values, *initial_memory(student.actor.memory, 200))[0] for values in (clear, noisy))
    assert 0 < (second - first).square().mean().sqrt() < 0.01


def test_it_sees_where_its_command_takes_the_end_effector(student):
    worlds = student.training.held_out
    q = ArmModel(worlds.task.robot).random_configurations(np.random.default_rng(0), 5)
    tips = ArmModel(worlds.task.robot).positions(q)
    observations = torch.as_tensor(np.hstack((tips, q, np.zeros((5, 6)))), dtype=torch.float32)
    memory = student.network.remember(initial_memory(student.network.memory, 5), torch.as_tensor(q))
    inputs = student.network.inputs(observations, *(values.float() for values in memory)).numpy()
    np.testing.assert_allclose(inputs[:, :9], observations[:, :9], atol=1e-5)
    np.testing.assert_allclose(inputs[:, 15:-1], 0, atol=1e-4)  # the arm does not lag


@pytest.mark.slow
@torch.no_grad()
def test_estimates_of_a_moving_target_are_exact_without_noise_and_steady_with_it(student):
    rng = np.random.default_rng(1)
    curve = TargetTrajectory(
        np.full(3, 0.4), rng.uniform(0.05, 0.1, (3, 2)), rng.uniform(1, 3.5, (3, 2)), rng.uniform(-3, 3, (3, 2))
    )
    times = PERIOD * np.arange(200)
    places = curve.positions(times)
    velocities = (curve.positions(times + 1e-4) - curve.positions(times - 1e-4)) / 2e-4
    clear = np.hstack((np.zeros((200, 9)), places, velocities))[:, None].repeat(20, 1)
    errors = []
    for noise in (0.0, 0.05):
        readings = torch.as_tensor(clear + noise * rng.standard_normal(clear.shape), dtype=torch.float32)
        memory, estimates = initial_memory(student.network.memory, 20), []
        for reading in readings:
            estimates.append(student.network.inputs(reading, *memory)[:, 9:12].numpy())
            _, *memory = student.network(reading, *memory)
        errors.append(np.sqrt(np.square(np.array(estimates)[50:] - clear[50:, :, 9:12]).mean()))
    assert errors[0] < 0.001
    assert errors[1] < 0.25 * 0.05


@pytest.mark.parametrize("noise", [0.0, 0.02, 0.05])
@torch.no_grad()
def test_estimates_of_boxes_are_means_of_all_readings_until_which_are_good_the_arm_waits(noise, tmp_path):
    student = student_of(recipe(OBSTACLES, "obstacles_plan_bc"), tmp_path / "run")
    worlds: Any = make_worlds(OBSTACLES, 3, {"disturbances": {"noise": noise}})
    observations, memory = worlds.reset(seed=2)[0], initial_memory(student.network.memory, 3)
    readings, moves = [], []
    for _ in range(10):
        readings.append(observations[:, 9:])
        estimates = student.network.inputs(tensors(observations), *memory)[:, 9 : observations.shape[1]]
        np.testing.assert_allclose(estimates, np.mean(readings, axis=0), atol=1e-5)
        commands, *memory = student.network(tensors(observations), *memory)
        moves.append((commands.numpy() != worlds.task.idle_action.astype(np.float32)).any(axis=1))
        observations = worlds.step(commands.numpy())[0]
    waiting = {0.0: [1] * 3, 0.02: [3, 4, 5, 6], 0.05: [10] * 3}[noise]
    assert set((~np.array(moves)).sum(axis=0)) <= set(waiting)


LOST_IMAGES = {"dynamics": "kinematic", "observation": "ranges", "disturbances": {"dropout": 0.5}}


@pytest.mark.one_case
@pytest.mark.parametrize(
    "changes",
    [
        {},
        {
            "env": BRIDGE,
            "teacher": "random",
            "training_options": LOST_IMAGES,
            "options": PLAIN | {"features": "robust"},
        },
        {"env": OBSTACLES, "teacher": "random", "options": PLAIN, "training_options": {"solvable": False}},
    ],
    ids=["commanding", "lost images", "features that learn"],
)
def test_replayed_steps_have_the_actions_that_were_chosen(changes, tmp_path):
    """Also after actions of the teacher, and after the ends of episodes."""
    student = student_of(recipe(**changes), tmp_path / "run")
    envs, chosen = student.training.envs, []
    batch = DistillationBatch(student, envs, teacher_in(envs.unwrapped, student.training.stage, 0))
    student.network.register_forward_hook(lambda module, arguments, results: chosen.append(results[0]))
    batch.play()
    assert 0 < sum(not step.ongoing.all() for step in batch._steps) < len(batch._steps)
    steps = batch._steps
    replayed = student.network.replay(
        [step.inputs for step in steps], [step.ongoing for step in steps], batch._initial_memory[0]
    )
    for own, actions in zip(chosen, replayed, strict=True):
        np.testing.assert_allclose(own.detach(), actions.detach(), atol=1e-5)


@pytest.mark.slow
def test_the_exported_graph_acts_as_the_network_over_an_episode(student, tmp_path):
    student.actor.export(tmp_path / "agent.onnx")
    graph = load_graph(tmp_path / "agent.onnx")
    worlds: Any = make_worlds(MOVING, 3, {"disturbances": {"noise": 0.02}})
    names, memory = list(student.actor.memory), [m.numpy() for m in initial_memory(student.actor.memory, 3)]
    observations, _ = worlds.reset(seed=1)
    for _ in range(10):
        actions, *memory = graph.run({INPUT: observations, **dict(zip(names, memory, strict=True))})
        np.testing.assert_allclose(actions, student.actor.act(observations), atol=1e-5)
        observations = worlds.step(actions)[0]


@pytest.mark.parametrize(
    "changes",
    [{"env": "armctl/BridgeCross-v0", "teacher": "bridge_ppo"}, {"env_options": {"control": "velocity"}}],
)
def test_other_robots_and_controls_are_refused(changes, tmp_path):
    with pytest.raises(ConfigurationError, match="joint positions"):
        student_of(recipe(**changes, training_options={}), tmp_path / "run")
