from pathlib import Path

import numpy as np
import pytest

from armctl.agents import OnnxPolicy, load_agent
from armctl.core.errors import AgentFileError, ConfigurationError
from armctl.envs import make_worlds
from armctl.rl.algorithms import distil, distilled_ppo
from armctl.rl.algorithms.asymmetric import STATE
from armctl.training.learners import Recipe

BRIDGE = "armctl/BridgeCross-v0"
CAMERA = {"resolution": (8, 6), "max_episode_steps": 6}
SIZES = {"worlds": 4, "hidden_units": 8, "layers": 2, "validation_episodes": 2, "evaluation_episodes": 2}
SMALL = SIZES | {"steps": 128, "critic_steps": 32, "rollout_length": 8, "batch_size": 16, "evaluation_every": 64}


@pytest.fixture(scope="module")
def student(tmp_path_factory):
    """The card of an agent that remembers, hardly trained."""
    out = tmp_path_factory.mktemp("runs") / "student"
    options = SIZES | {"steps": 64, "length": 8, "memory_units": 5, "evaluation_every": 64}
    chosen = Recipe(
        name="student",
        learner="distil",
        env=BRIDGE,
        env_options=CAMERA,
        teacher="bridge_ompl:prepared=false",
        options=options,
    )
    distil.train(chosen, out=out, seed=0, progress=False)
    return str(out / "agent.json")


def recipe(teacher, env=BRIDGE, env_options=CAMERA, **options):
    return Recipe(
        name="distilled_ppo", learner="distilled_ppo", env=env, env_options=env_options, teacher=teacher,
        options=SMALL | options,
    )  # fmt: skip


def trained(chosen, out, **how):
    return distilled_ppo.train(chosen, out=out, seed=0, progress=False, **how)


def played(policies, steps=8):
    """What policies do in the same worlds, led by the first of them, one of whose episodes begins anew on the way."""
    worlds = make_worlds(BRIDGE, 3, CAMERA)
    observations, _ = worlds.reset(seed=3)
    actions = []
    for t in range(steps):
        if t == 5:
            for policy in policies:
                policy.reset(np.array([1], dtype=np.int32))
        actions.append([policy.act(observations) for policy in policies])
        observations = worlds.step(actions[-1][0])[0]
    return np.array(actions).swapaxes(0, 1)


def weights(path, part):
    worlds = make_worlds(BRIDGE, 1, CAMERA)
    numbers = load_agent(Path(path), worlds).numbers
    return {name: values for name, values in numbers.items() if part in name}


@pytest.mark.slow
def test_ppo_starts_from_what_the_agent_does(student, tmp_path, monkeypatch):
    monkeypatch.setattr(distilled_ppo.AnchoredPpo, "train", lambda model: None)
    card = trained(recipe(student), tmp_path / "run")
    assert card.memory == {"hidden": [5]}
    teacher, agent = (
        load_agent(Path(path), make_worlds(BRIDGE, 3, CAMERA)) for path in (student, tmp_path / "run/agent.json")
    )
    before, after = played([teacher, agent])
    np.testing.assert_allclose(after, before, atol=1e-5)
    assert before.std(axis=0).max() > 1e-4


@pytest.mark.slow
@pytest.mark.parametrize("privileged", [False, True])
def test_only_the_layers_from_memory_to_actions_change(student, privileged, tmp_path):
    card = trained(recipe(student, privileged_critic=privileged, learning_rate=1e-2), tmp_path / "run")
    assert (card.training_steps, card.teacher_queries, card.observation_shape["motion"]) == (128, 0, [3])
    path = tmp_path / "run" / "checkpoints" / "128.zip"
    model = distilled_ppo.AnchoredPpo.load(path, device="cpu")
    assert (STATE in getattr(model.observation_space, "spaces", {})) == privileged
    learnt = model.policy.mlp_extractor.policy_net[0].weight.detach().numpy()
    assert not np.allclose(learnt, weights(student, "head.0.weight")["network.head.0.weight"])
    for part in ("encoder.1", "unit"):
        before, after = weights(student, part), weights(tmp_path / "run/agent.json", part)
        assert len(before) == len(after) >= 2
        for old, new in zip(before.values(), after.values(), strict=True):
            assert np.array_equal(old, new)


@pytest.mark.slow
def test_a_training_resumes(student, tmp_path, unexported):
    chosen = recipe(student)
    trained(chosen, tmp_path / "run")
    more = chosen.changed(options=chosen.options | {"steps": 192})
    assert trained(more, tmp_path / "run", resume=True).training_steps == 192


@pytest.mark.slow
def test_stages_that_show_ranges_and_the_camera(student, tmp_path, unexported):
    chosen = recipe(student).changed(
        training_options={"dynamics": "kinematic", "observation": "ranges"}, curriculum=[{"after": 0.5}]
    )
    assert trained(chosen, tmp_path / "run").training_steps == 128


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"teacher": None}, "starts from an agent: name it"),
        ({"teacher": "bridge_ompl"}, "bridge_ompl is none"),
        ({"options": SMALL | {"frames": 2}}, "leave the option frames out"),
        ({"options": SMALL | {"hidden_units": 16}}, "trained with hidden_units 8: set that option, not 16"),
        ({"options": SMALL | {"layers": 1}}, "trained with layers 2: set that option, not 1"),
        ({"options": SMALL | {"features": "none"}}, "trained with features 'invariant': set that option, not 'none'"),
        ({"env_options": {"resolution": (12, 8)}}, "here they are"),
    ],
)
def test_what_it_cannot_start_from_is_refused_before_a_folder_is_made(student, changes, message, tmp_path):
    with pytest.raises((ConfigurationError, AgentFileError), match=message):
        trained(recipe(student).changed(**changes), tmp_path / "run")
    assert not (tmp_path / "run").exists()


@pytest.mark.slow
def test_an_agent_whose_network_is_another_is_refused(student, tmp_path, monkeypatch):
    monkeypatch.setattr(OnnxPolicy, "numbers", {"weights": np.zeros(3)})
    with pytest.raises(ConfigurationError, match=r"with weights network.encoder.1.weight of shape \(8, 11\)"):
        trained(recipe(student), tmp_path / "run")
    assert not (tmp_path / "run").exists()
