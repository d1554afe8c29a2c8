from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import torch

from armctl.agents import OnnxPolicy, load_agent, read_card
from armctl.core.errors import AgentFileError, ConfigurationError
from armctl.envs import make_worlds
from armctl.policies import make_policy
from armctl.rl.algorithms import ppo
from armctl.rl.algorithms.distil import DistillationBatch, DistilOptions, Student, train
from armctl.rl.data.demonstrations import teacher_in
from armctl.rl.run.training import Training
from armctl.training.learners import Recipe, load_recipe

TEACHER = f"{Path(__file__).parents[1] / 'preparations.py'}:Alternating"
REACH = {"actions": "normalized", "max_episode_steps": 10}
SMALL = {
    "steps": 16 * 8 * 75, "worlds": 16, "length": 8, "epochs": 2, "hidden_units": 32, "memory_units": 16,
    "learning_rate": 1e-2, "mixed_steps": 2000, "evaluation_every": 16 * 8 * 50, "validation_episodes": 3,
    "evaluation_episodes": 3,
}  # fmt: skip
CAMERA = {"resolution": (8, 6), "max_episode_steps": 6}


def recipe(env="armctl/ArmReach-v0", env_options=REACH, teacher=TEACHER, training_options=None, **options):
    return Recipe(
        name="distil", learner="distil", env=env, env_options=env_options, teacher=teacher,
        training_options=training_options or {}, options=SMALL | options,
    )  # fmt: skip


def started(chosen, out):
    """A training that has just begun, and its student."""
    training = Training(chosen, chosen.read_options(DistilOptions), out, 0, False)
    return training, Student(training, training.options)


@pytest.fixture(scope="module")
def distilled(tmp_path_factory):
    out = tmp_path_factory.mktemp("runs") / "distilled"
    return out, train(recipe(), out=out, seed=0, progress=False)


@pytest.fixture(scope="module")
def state_agent(tmp_path_factory):
    out = tmp_path_factory.mktemp("runs") / "state"
    options = {"steps": 16, "worlds": 2, "rollout_length": 4, "batch_size": 8, "validation_episodes": 2,
               "evaluation_episodes": 2}  # fmt: skip
    chosen = load_recipe("bridge_state_ppo").changed(
        env_options={"observation": "state", "max_episode_steps": 6}, training_options={}, options=options
    )
    ppo.train(chosen, out=out, seed=0, progress=False)
    return out / "agent.json"


@pytest.mark.slow
def test_a_student_gets_near_to_labels_that_need_a_memory(distilled):
    out, card = distilled
    assert (card.learner, card.teacher, card.memory) == ("distil", TEACHER, {"hidden": [16]})
    assert card.decisions == card.teacher_queries == card.training_steps == SMALL["steps"]
    assert card.gradient_steps == 150
    worlds = make_worlds("armctl/ArmReach-v0", 4, REACH)
    training = Training(recipe(), recipe().read_options(DistilOptions), out, 0, True)
    student, teacher = Student(training, training.options).actor, make_policy(TEACHER, worlds)
    observations, _ = worlds.reset(seed=5)
    for policy in (student, teacher):
        policy.reset(np.arange(4, dtype=np.int32))
    errors = []
    for _ in range(10):
        own, labels = student.act(observations), teacher.act(observations)
        errors.append(np.square(own - labels).mean())
        observations = worlds.step(own)[0]
    assert np.mean(errors) < 0.02  # 0.25 without a memory


@pytest.mark.slow
def test_the_graph_remembers_as_the_network_does_and_each_world_alone(distilled):
    out, _ = distilled
    worlds = make_worlds("armctl/ArmReach-v0", 3, REACH)
    chosen = recipe()
    training = Training(chosen, chosen.read_options(DistilOptions), out, 0, True)
    actor = Student(training, training.options).actor
    actor.load_state_dict(torch.load(out / "best.pt", weights_only=True)["actor"])
    together, *alone = [load_agent(out / "agent.json", worlds) for _ in range(4)]
    observations, _ = worlds.reset(seed=1)
    for t in range(8):
        if t == 5:
            for policy in (actor, together):
                policy.reset(np.array([1], dtype=np.int32))
            alone[1].reset(np.array([0], dtype=np.int32))
        actions = together.act(observations)
        np.testing.assert_allclose(actions, actor.act(observations), atol=1e-5)
        for i, policy in enumerate(alone):
            assert np.array_equal(policy.act(observations[i : i + 1])[0], actions[i])
        observations = worlds.step(actions)[0]


@pytest.mark.slow
def test_a_training_resumes_where_it_was(tmp_path, unexported):
    short = recipe(steps=512, evaluation_every=256)
    first = train(short, out=tmp_path / "run", seed=0, progress=False)
    assert pd.read_csv(tmp_path / "run" / "curve.csv").steps.tolist() == [0, 256, 512]
    longer = short.changed(options=short.options | {"steps": 768})
    training = Training(longer, longer.read_options(DistilOptions), tmp_path / "run", 0, True)
    student = Student(training, training.options)
    assert (student.steps, first.gradient_steps) == (512, 8)
    assert student._optimizer.state_dict()["state"][0]["step"] == 8
    card = train(longer, out=tmp_path / "run", seed=0, resume=True, progress=False)
    assert (card.training_steps, card.gradient_steps, card.decisions) == (768, 12, 768)
    assert pd.read_csv(tmp_path / "run" / "curve.csv").steps.tolist() == [0, 256, 512, 768]
    with pytest.raises(ConfigurationError, match="memory_units 16, not 8"):
        train(recipe(steps=768, evaluation_every=256, memory_units=8), out=tmp_path / "run", seed=0, resume=True)


@pytest.mark.slow
def test_an_interrupt_leaves_a_checkpoint(tmp_path, monkeypatch, unexported):
    step = DistillationBatch._step

    def interrupted(batch):
        if batch._student.steps == 256:
            raise KeyboardInterrupt
        return step(batch)

    monkeypatch.setattr(DistillationBatch, "_step", interrupted)
    with pytest.raises(KeyboardInterrupt):
        train(recipe(steps=512), out=tmp_path / "run", seed=0, progress=False)
    monkeypatch.undo()
    assert (tmp_path / "run" / "checkpoints" / "256.zip").exists()
    assert train(recipe(steps=512), out=tmp_path / "run", seed=0, resume=True, progress=False).gradient_steps == 8


def test_a_student_forgets_finished_episodes_and_so_does_the_teacher(tmp_path):
    chosen = recipe(env_options=REACH | {"max_episode_steps": 3}, length=1)
    training, student = started(chosen, tmp_path / "run")
    teacher: Any = make_policy(TEACHER, training.envs.unwrapped)
    batch = DistillationBatch(student, training.envs, teacher)
    for t in range(1, 7):
        batch.play()
        (hidden,) = batch._memory
        assert (hidden == 0).all() == (t % 3 == 0)
        assert {one.policy.step if hasattr(one, "policy") else one.step for one in teacher.controllers} == {t % 3}


def test_gradients_flow_through_a_batch_and_no_further(tmp_path):
    training, student = started(recipe(), tmp_path / "run")
    batch = DistillationBatch(student, training.envs, make_policy(TEACHER, training.envs.unwrapped))
    for _ in range(2):
        batch.play()
        student.network.zero_grad()
        batch.loss(np.arange(16)).backward()  # which fails if a graph is used again
        assert student.network.unit.weight_hh.grad.abs().max() > 0


def test_minibatches_are_all_worlds_once_in_an_epoch(tmp_path):
    training, student = started(recipe(), tmp_path / "run")
    batch = DistillationBatch(student, training.envs, make_policy(TEACHER, training.envs.unwrapped))
    batch.play()
    groups = list(batch.minibatches(2, 4))
    assert [len(rows) for rows in groups] == [4] * 8
    for epoch in (groups[:4], groups[4:]):
        assert sorted(np.concatenate(epoch)) == list(range(16))
        losses = [batch.loss(rows).item() for rows in epoch]
        assert np.mean(losses) == pytest.approx(batch.loss(np.arange(16)).item(), rel=1e-5)


@pytest.mark.parametrize(("mixed_steps", "share"), [(10**9, 1.0), (0, 0.0)])
def test_the_teacher_acts_at_first(mixed_steps, share, tmp_path, monkeypatch):
    training, student = started(recipe(mixed_steps=mixed_steps), tmp_path / "run")
    taken, step = [], type(training.envs).step
    monkeypatch.setattr(
        type(training.envs), "step", lambda worlds, actions: taken.append(actions) or step(worlds, actions)
    )
    DistillationBatch(student, training.envs, make_policy(TEACHER, training.envs.unwrapped)).play()
    assert np.isin(taken, (0.5, -0.5)).mean() == share


def test_labels_of_late_actions_are_those_of_the_states_in_which_they_arrive(tmp_path):
    disturbances = {"disturbances": {"delay": (0, 2), "noise": 0.1}}
    training, student = started(
        recipe(training_options=disturbances, env_options=REACH | {"max_episode_steps": 6}), tmp_path / "run"
    )
    envs = training.envs.unwrapped
    batch = DistillationBatch(student, training.envs, teacher_in(envs, training.stage, 0))
    delays = envs.disturbances["delay"].levels.astype(int)
    assert set(delays) == {0, 1, 2}
    batch.play()
    for world, delay in enumerate(delays):
        labels = [step.targets[world, 0].item() for step in batch._steps]
        assert labels[: 6 - delay] == [0.5 if (t + delay) % 2 == 0 else -0.5 for t in range(6 - delay)]
        known = [step.is_labelled[world].item() for step in batch._steps]
        assert known[:6] == [True] * (6 - delay) + [False] * delay  # the episode ends before the others arrive


def test_a_teacher_sees_no_disturbance():
    worlds: Any = make_worlds("armctl/ArmReach-v0", 3, {"disturbances": {"noise": 0.1}})
    teacher = teacher_in(worlds, recipe(teacher="reach_ik:prepared=false"), 0)
    clear: Any = make_worlds("armctl/ArmReach-v0", 3)
    expert = make_policy("reach_ik:prepared=false", clear)
    noisy, observations = worlds.reset(seed=2)[0], clear.reset(seed=2)[0]
    assert not np.array_equal(noisy, observations)
    assert np.array_equal(teacher.act(noisy), expert.act(observations))


def test_a_student_starts_from_another_agent(tmp_path):
    chosen = load_recipe("bridge_robust_distil")
    training, student = started(chosen, tmp_path / "run")
    weights = load_agent(Path("rl/agents/bridge_distil.json"), training.held_out).numbers
    for name, parameter in student.network.named_parameters():
        assert np.array_equal(parameter.detach().numpy(), weights[f"network.{name}"])
    assert {"bridge_distil", "bridge_state_ppo"} <= {ancestor.name for ancestor in training._lineage}
    with pytest.raises(ConfigurationError, match="as distil trains it"):
        started(chosen.changed(options=chosen.options | {"start": "random"}), tmp_path / "other")


@pytest.mark.slow
def test_an_agent_of_the_state_teaches_a_student_who_sees_the_camera(state_agent, tmp_path):
    """It labels the states of the very worlds that the student is in."""
    options: dict[str, Any] = {"env": "armctl/BridgeCross-v0", "env_options": CAMERA, "teacher": str(state_agent)}
    seen, shown = (make_worlds(options["env"], 3, CAMERA | more) for more in ({}, {"observation": "state"}))
    teacher, agent = teacher_in(seen, recipe(**options), 0), load_agent(state_agent, shown)
    assert isinstance(agent, OnnxPolicy)
    observations, states = seen.reset(seed=3)[0], shown.reset(seed=3)[0]
    for _ in range(4):
        labels = teacher.act(observations)
        assert np.array_equal(labels, agent.act(states))
        observations, states = seen.step(labels)[0], shown.step(labels)[0]
    card = train(
        recipe(**options, worlds=2, length=4, steps=16, evaluation_every=8),
        out=tmp_path / "run",
        seed=0,
        progress=False,
    )
    assert (card.observation_shape, card.memory) == ({"image": [6, 8], "motion": [3]}, {"hidden": [16]})
    assert load_agent(tmp_path / "run" / "agent.json", seen).act(observations).shape == (3, 2)
    assert read_card(tmp_path / "run" / "agent.json").sees == "observation"


@pytest.mark.slow
def test_an_agent_of_another_state_is_no_teacher(state_agent, tmp_path):
    chosen = recipe("armctl/BridgeCross-v0", CAMERA | {"blocks": 3}, str(state_agent))
    with pytest.raises(AgentFileError, match="observations"):
        train(chosen, out=tmp_path / "run", seed=0, progress=False)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"teacher": None}, "--teacher"),
        ({"teacher": "reach_ki"}, "Did you mean 'reach_ik'"),
        ({"teacher": "reach_ik"}, "physical units"),
        ({"shaping": "distance"}, "not learn from rewards"),
        ({"options": {"memory_unit": 3}}, "Did you mean 'memory_units'"),
        ({"options": {"minibatches": 17, "worlds": 16}}, "16 worlds cannot be split into 17 minibatches"),
        ({"options": {"length": 0}}, "length: .*greater than or equal to 1"),
        ({"curriculum": [{"after": 0.5, "reward_weights": {"goal": 2.0}}]}, "not learn from rewards"),
    ],
)
def test_mistakes_get_one_clear_error(changes, says, tmp_path):
    with pytest.raises(ConfigurationError, match=says):
        train(recipe().changed(**changes), out=tmp_path / "run", seed=0, progress=False)
    assert not (tmp_path / "run").exists()
