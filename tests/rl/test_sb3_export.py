import base64
import json
import pickle
import re
import zipfile
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import torch
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize, VecTransposeImage

from armctl.agents import load_agent, read_card
from armctl.envs import make_worlds
from armctl.errors import AgentFileError
from armctl.rl import sb3_check, sb3_file
from armctl.rl.sb3_export import export
from tests.command_line import armctl
from tests.rl.sb3_models import A2C, DDPG, DQN, PPO, SAC, TD3, TQC, RecurrentPPO, make, register

register()
SMALL = {"buffer_size": 100}
LSTM = {"lstm_hidden_size": 16}


def exported(model, env, folder, *arguments):
    """The card and the agent, loaded for n worlds, of a model that the command line has exported."""
    model.save(folder / "model.zip")
    said = armctl("export", "model.zip", "--env", env, "--out", "agent.onnx", "--trust", *arguments, cwd=folder).stdout
    assert "act alike on 1,000 observations" in said
    card = read_card(folder / "agent.json")
    return card, lambda n: load_agent(folder / "agent.onnx", make_worlds(env, n))


def observations(env, steps, n, seed=5):
    """Observations (steps, n) of random actions, and where episodes begin (steps, n)."""
    worlds = make_worlds(env, n)
    worlds.single_action_space.seed(seed)
    seen, _ = worlds.reset(seed=seed)
    began, shown = [np.ones(n, dtype=bool)], [seen]
    for _ in range(steps - 1):
        actions = np.array([worlds.single_action_space.sample() for _ in range(n)])
        seen, _, terminated, truncated, _ = worlds.step(actions)
        over = terminated | truncated
        if over.any():
            seen, _ = worlds.reset(options={"reset_mask": over})
        shown.append(seen)
        began.append(over)
    return shown, began


def rows(observations, chosen):
    if isinstance(observations, dict):
        return {name: values[chosen] for name, values in observations.items()}
    return observations[chosen]


def check_acts_alike(model, agent, env, normalise=lambda seen: seen, steps=250, n=4):
    shown, began = observations(env, steps, n)
    state, wanted, found = None, [], []
    for seen, starts in zip(shown, began, strict=True):
        agent.reset(np.flatnonzero(starts).astype(np.int32))
        action, state = model.predict(normalise(seen), state, starts, deterministic=True)
        wanted.append(action)
        found.append(agent.act(seen))
    wanted, found = np.array(wanted), np.array(found)
    assert wanted.shape[:2] == (steps, n)
    assert len(np.unique(wanted.reshape(steps * n, -1), axis=0)) > 1, "the actions differ"
    np.testing.assert_allclose(found, wanted, atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize(
    ("kind", "env", "name", "options"),
    [
        (PPO, "Pendulum-v1", "ppo", {}),
        (PPO, "CartPole-v1", "ppo", {}),
        (PPO, "Pendulum-v1", "ppo", {"use_sde": True, "policy_kwargs": {"squash_output": True}}),
        (A2C, "CartPole-v1", "a2c", {}),
        (SAC, "Pendulum-v1", "sac", SMALL),
        (SAC, "Pendulum-v1", "sac", SMALL | {"use_sde": True}),
        (TD3, "Pendulum-v1", "td3", SMALL),
        (DDPG, "Pendulum-v1", "ddpg", SMALL),
        (TQC, "Pendulum-v1", "tqc", SMALL),
        (DQN, "sb3/vector-choice-v0", "dqn", SMALL),
        (PPO, "armctl/ArmReach-v0", "ppo", {}),
    ],
)
def test_an_agent_acts_as_its_model(kind, env, name, options, tmp_path):
    model = make(kind, env, **options)
    card, load = exported(model, env, tmp_path)
    assert (card.learner, card.env, card.training_seed, card.training_minutes) == (f"sb3-{name}", env, 0, None)
    assert card.conversion.observations == 1000
    assert card.conversion.largest_difference <= 1e-5
    assert card.learner_options["gamma"] == 0.99
    check_acts_alike(model, load(4), env)


@pytest.mark.parametrize(
    ("seen", "done", "policy", "options"),
    [
        ("image", "choice", "CnnPolicy", {}),
        ("parts", "push", "MultiInputPolicy", {}),
        ("number", "choices", "MlpPolicy", {}),
        ("numbers", "switches", "MlpPolicy", {}),
        ("bits", "table", "MlpPolicy", {}),
        ("double", "exact", "MlpPolicy", {}),
    ],
)
def test_any_observations_and_actions(seen, done, policy, options, tmp_path):
    env = f"sb3/{seen}-{done}-v0"
    model = make(PPO, env, policy, **options)
    _, load = exported(model, env, tmp_path)
    check_acts_alike(model, load(3), env, n=3, steps=40)


def test_squashed_actions_in_double_precision(tmp_path):
    model = make(SAC, "sb3/double-exact-v0", **SMALL)
    _, load = exported(model, "sb3/double-exact-v0", tmp_path)
    check_acts_alike(model, load(3), "sb3/double-exact-v0", n=3)


RECURRENT = {
    "two LSTMs": LSTM,
    "shared": LSTM | {"shared_lstm": True, "enable_critic_lstm": False},
    "actor's only": LSTM | {"enable_critic_lstm": False},
    "two layers": LSTM | {"n_lstm_layers": 2},
}


@pytest.mark.parametrize("variant", RECURRENT)
def test_a_recurrent_agent_remembers_and_forgets(variant, tmp_path):
    env = "sb3/vector-push-v0"
    model = make(RecurrentPPO, env, "MlpLstmPolicy", policy_kwargs=RECURRENT[variant])
    card, load = exported(model, env, tmp_path)
    layers = RECURRENT[variant].get("n_lstm_layers", 1)
    assert card.memory == {"lstm_hidden": [layers, 16], "lstm_cell": [layers, 16]}
    check_acts_alike(model, load(4), env)


def test_a_recurrent_agent_of_parts_and_choices(tmp_path):
    model = make(RecurrentPPO, "sb3/two-choices-v0", "MultiInputLstmPolicy", policy_kwargs=LSTM)
    _, load = exported(model, "sb3/two-choices-v0", tmp_path)
    check_acts_alike(model, load(4), "sb3/two-choices-v0")


def test_a_world_remembers_the_same_whatever_the_number_of_worlds(tmp_path):
    env = "sb3/vector-push-v0"
    _, load = exported(make(RecurrentPPO, env, "MlpLstmPolicy", policy_kwargs=LSTM), env, tmp_path)
    shown, began = observations(env, 30, 9)
    shown[15], began[17] = shown[15], began[17] | (np.arange(9) % 2 == 0)
    played = {}
    for n in (1, 2, 3, 5, 8, 9):
        agent, actions = load(n), []
        for seen, starts in zip(shown, began, strict=True):
            agent.reset(np.flatnonzero(starts[:n]).astype(np.int32))
            actions.append(agent.act(seen[:n]))
        played[n] = np.array(actions)
    for n, actions in played.items():
        np.testing.assert_array_equal(actions, played[9][:, :n])
    assert not np.array_equal(load(1).act(shown[1][:1]), played[1][1]), "what it remembers matters"


def test_an_agent_that_is_reset_acts_as_a_new_one(tmp_path):
    env = "sb3/vector-push-v0"
    _, load = exported(make(RecurrentPPO, env, "MlpLstmPolicy", policy_kwargs=LSTM), env, tmp_path)
    shown, _ = observations(env, 4, 2)
    used = load(2)
    for seen in shown:
        used.act(seen)
    used.reset(np.array([1], dtype=np.int32))
    now, fresh = used.act(shown[0]), load(2).act(shown[0])
    np.testing.assert_array_equal(now[1], fresh[1])
    assert not np.array_equal(now[0], fresh[0])


def normalised(env, folder, name="vecnormalize.pkl", **options):
    """Statistics of an environment, saved, and as `predict` is used with them."""
    venv = VecNormalize(DummyVecEnv([lambda: gymnasium.make(env)]), **options)
    venv.seed(0)
    venv.reset()
    for _ in range(50):
        venv.step(np.array([venv.action_space.sample()]))
    venv.save(str(folder / name))
    return venv


@pytest.mark.parametrize(("name", "given"), [("vecnormalize.pkl", []), ("other.pkl", ["--vecnormalize", "other.pkl"])])
def test_normalised_observations(name, given, tmp_path):
    venv = normalised("Pendulum-v1", tmp_path, name, clip_obs=1.0)
    model = make(PPO, venv)
    card, load = exported(model, "Pendulum-v1", tmp_path, *given)
    assert card.conversion.normalisation == name
    check_acts_alike(model, load(4), "Pendulum-v1", venv.normalize_obs)


def test_parts_that_are_normalised_and_parts_that_are_not(tmp_path):
    venv = normalised("sb3/two-push-v0", tmp_path, norm_obs_keys=["place"])
    model = make(SAC, venv, "MultiInputPolicy", **SMALL)
    _, load = exported(model, "sb3/two-push-v0", tmp_path)
    check_acts_alike(model, load(3), "sb3/two-push-v0", venv.normalize_obs, n=3)


def test_a_recurrent_agent_of_normalised_observations(tmp_path):
    venv = normalised("Pendulum-v1", tmp_path, "vec_normalize.pkl")
    model = make(RecurrentPPO, venv, "MlpLstmPolicy", policy_kwargs=LSTM)
    _, load = exported(model, "Pendulum-v1", tmp_path)
    check_acts_alike(model, load(4), "Pendulum-v1", venv.normalize_obs)


def test_normalised_images(tmp_path):
    env = "sb3/image-push-v0"
    venv = normalised(env, tmp_path)
    model = make(PPO, venv, policy_kwargs={"normalize_images": False})
    _, load = exported(model, env, tmp_path)
    check_acts_alike(model, load(2), env, venv.normalize_obs, n=2, steps=30)


def test_without_statistics_that_lie_beside_it(tmp_path):
    normalised("Pendulum-v1", tmp_path)
    model = make(PPO, "Pendulum-v1")
    card, load = exported(model, "Pendulum-v1", tmp_path, "--vecnormalize", "none")
    assert card.conversion.normalisation is None
    check_acts_alike(model, load(4), "Pendulum-v1")


@pytest.mark.parametrize(
    "beside",
    ["vecnormalize.pkl", "vec_normalize.pkl", "rl_vecnormalize_500_steps.pkl", "rl_500_steps/vecnormalize.pkl"],
)
def test_where_statistics_are_looked_for(beside, tmp_path):
    model = tmp_path / "rl_500_steps.zip"
    assert sb3_file.normalisation_beside(model) is None
    (tmp_path / beside).parent.mkdir(exist_ok=True)
    (tmp_path / beside).touch()
    assert sb3_file.normalisation_beside(model) == tmp_path / beside


def test_a_trained_model_and_what_its_card_says(tmp_path):
    model = TQC(
        "MlpPolicy", "Pendulum-v1", seed=3, learning_starts=50, policy_kwargs={"net_arch": [16]}, buffer_size=500
    )
    model.learn(120)
    card, load = exported(model, "Pendulum-v1", tmp_path)
    assert (card.name, card.training_steps, card.training_seed, card.interface) == ("agent", 120, 3, {})
    assert card.learner_options["policy_kwargs"]["net_arch"] == [16]
    assert card.learner_options["top_quantiles_to_drop_per_net"] == 2
    assert card.conversion.saved_with.startswith("stable-baselines3 2.")
    check_acts_alike(model, load(4), "Pendulum-v1")
    assert "/" not in json.dumps([card.versions, card.learner_options]), "no paths"


def test_the_environment_s_options_are_on_the_card(tmp_path):
    env, options = "armctl/ArmReach-v0", ["--set", "robot=ur10", "--set", "max_episode_steps=9"]
    make(PPO, gymnasium.make(env, robot="ur10")).save(tmp_path / "model.zip")
    done = armctl("export", "model.zip", "--env", env, *options, "--trust", cwd=tmp_path)
    card = read_card(tmp_path / "model.json")
    assert card.env_options == {"robot": "ur10", "max_episode_steps": 9}
    assert card.interface["robot"] == "ur10"
    assert " ".join(options) in done.stdout
    options[1] = "robot=panda"
    refused = armctl("export", "model.zip", "--env", env, *options, "--trust", "--overwrite", cwd=tmp_path, check=False)
    assert refused.returncode == 2
    assert "trained with" in refused.stderr


class Harmful:
    """Creates a file when it is unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


def poisoned(path, witness):
    """A model whose pickled policy class would create the file `witness`."""
    make(PPO, "Pendulum-v1").save(path)
    with zipfile.ZipFile(path) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    data = json.loads(files["data"])
    data["policy_class"][":serialized:"] = base64.b64encode(pickle.dumps(Harmful(witness))).decode()
    files["data"] = json.dumps(data).encode()
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)


@pytest.mark.parametrize("trust", [False, True])
def test_nothing_is_unpickled_without_trust(trust, tmp_path):
    poisoned(tmp_path / "model.zip", tmp_path / "from_model")
    (tmp_path / "vecnormalize.pkl").write_bytes(pickle.dumps(Harmful(tmp_path / "from_statistics")))
    arguments = ["export", "model.zip", "--env", "Pendulum-v1", *["--trust"][: int(trust)]]
    done = armctl(*arguments, cwd=tmp_path, check=False)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert ("can run any code" in done.stderr) is not trust
    assert (tmp_path / "from_model").exists() is trust, "and with trust, the test would notice"
    assert not (tmp_path / "from_statistics").exists()
    assert not list(tmp_path.glob("*.onnx"))


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """A folder with models, and files that are none."""
    folder = tmp_path_factory.mktemp("saved")
    make(PPO, "Pendulum-v1").save(folder / "model.zip")
    make(PPO, "sb3/two-push-v0", "MultiInputPolicy").save(folder / "parts.zip")
    (folder / "empty.zip").touch()
    (folder / "cut.zip").write_bytes((folder / "model.zip").read_bytes()[:5000])
    for name, files in {"foreign": {"a": "b"}, "list": {"data": "[]"}, "json": {"data": "{"}}.items():
        with zipfile.ZipFile(folder / f"{name}.zip", "w") as archive:
            for file, content in files.items():
                archive.writestr(file, content)
    (folder / "junk.pkl").write_bytes(b"junk")
    (folder / "list.pkl").write_bytes(pickle.dumps([1]))
    (folder / "model.onnx").write_text("there")
    normalised("CartPole-v1", folder, "cartpole.pkl")
    normalised("sb3/two-push-v0", folder, "parts.pkl")
    return folder


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["nowhere.zip"], "nowhere.zip cannot be read: No such file"),
        (["empty.zip"], "empty.zip is not a zip file"),
        (["cut.zip"], "cut.zip is not a zip file"),
        (["foreign.zip"], "foreign.zip is not a model"),
        (["list.zip"], "list.zip is not a model"),
        (["json.zip"], "json.zip is not a zip file"),
        (["model.pt"], "model.pt cannot be exported: models are files .zip"),
        (["model.zip", "--out", "agent.json"], "an agent is a file .onnx"),
        (["model.zip", "--out", "model.onnx"], "--overwrite"),
        (["model.zip", "--env", "CartPole-v1"], "trained with actions Box"),
        (["model.zip", "--env", "armctl/ArmReach-v0"], "trained with actions Box"),
        (["model.zip", "--env", "MountainCarContinuous-v0"], "trained with actions Box"),
        (["parts.zip", "--env", "sb3/vector-push-v0"], "trained with observations Dict"),
        (["model.zip", "--env", "Pendulum-v11"], "no environment"),
        (["model.zip", "--vecnormalize", "none.pkl"], "none.pkl cannot be read: No such file"),
        (["model.zip", "--vecnormalize", "junk.pkl"], "junk.pkl cannot be loaded"),
        (["model.zip", "--vecnormalize", "list.pkl"], "list.pkl holds a list"),
        (["model.zip", "--vecnormalize", "cartpole.pkl"], "shape (4,)"),
        (["model.zip", "--vecnormalize", "parts.pkl"], "there is none"),
        (["model.zip", "--algorithm", "ppoo"], "Did you mean 'ppo'"),
        (["model.zip", "--algorithm", "sac"], "cannot be loaded as a model of sac"),
        (["model.zip", "--out", "/dev/null/agent.onnx"], "cannot be written"),
        (["model.zip", "--out", "/proc/agent.onnx"], "cannot be written"),
    ],
)
def test_mistakes_get_one_clear_line_and_leave_nothing(arguments, says, saved):
    before = sorted(saved.rglob("*"))
    default = {"--env": "Pendulum-v1", "--out": "agent.onnx"}
    given = [
        *arguments,
        *(word for option, value in default.items() if option not in arguments for word in (option, value)),
    ]
    done = armctl("export", *given, "--trust", cwd=saved, check=False)
    assert done.returncode == 2
    assert says in done.stderr
    assert done.stderr.count("\n") == 1
    assert sorted(saved.rglob("*")) == before


def test_an_agent_is_replaced_if_told_so(tmp_path):
    model = make(PPO, "Pendulum-v1")
    exported(model, "Pendulum-v1", tmp_path)
    exported(model, "Pendulum-v1", tmp_path, "--overwrite")


def test_an_agent_that_acts_otherwise_is_not_written(tmp_path, monkeypatch):
    model = make(PPO, "Pendulum-v1")
    model.save(tmp_path / "model.zip")
    predict = PPO.predict
    monkeypatch.setattr(PPO, "predict", lambda *a, **k: (predict(*a, **k)[0] + 0.01, None))
    with pytest.raises(AgentFileError, match=r"differ by 0\.00\d+ of the range"):
        export(tmp_path / "model.zip", env="Pendulum-v1", out=tmp_path / "agents" / "agent.onnx", trust=True)
    assert [path.name for path in tmp_path.iterdir()] == ["model.zip"]


def test_a_model_that_diverged_is_not_written(tmp_path):
    model = make(PPO, "Pendulum-v1")
    with torch.no_grad():
        model.policy.action_net.bias.fill_(np.nan)
    model.save(tmp_path / "model.zip")
    done = armctl("export", "model.zip", "--env", "Pendulum-v1", "--trust", cwd=tmp_path, check=False)
    assert done.returncode == 2
    assert re.fullmatch(r"armctl: the model cannot act in Pendulum-v1: ValueError: .*\n", done.stderr)
    assert not list(tmp_path.glob("*.onnx"))


def test_differences_are_shares_of_the_range():
    push = gymnasium.spaces.Box(np.array([-1.0, 0.0]), np.array([3.0, 1.0]), dtype=np.float64)
    wanted, found = np.array([[1.0, 3.0], [0.0, 0.0]]), np.array([[1.4, 3.0], [0.0, 0.5]])
    np.testing.assert_allclose(sb3_check._difference(push, wanted, found), [0.1, 0.5])
    choice = gymnasium.spaces.Discrete(3)
    np.testing.assert_array_equal(sb3_check._difference(choice, np.array([0, 2]), np.array([0, 1])), [0, 1])
    with pytest.raises(AgentFileError, match="shape"):
        sb3_check._difference(choice, np.array([0, 2]), np.array([[0], [1]]))


def test_channels_may_have_been_first_already(tmp_path):
    env = "sb3/image-choice-v0"
    model = make(DQN, VecTransposeImage(DummyVecEnv([lambda: gymnasium.make(env)])), "CnnPolicy", **SMALL)
    _, load = exported(model, env, tmp_path)
    check_acts_alike(model, load(2), env, n=2, steps=30)
