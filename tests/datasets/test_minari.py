import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from armctl.core.errors import ConfigurationError, ResultsError
from armctl.datasets.collect import collect
from armctl.datasets.demonstrations import demonstrate
from armctl.datasets.minari import read_demonstrations
from armctl.envs import make_worlds
from armctl.episodes import PolicyFailed
from armctl.policies import make_policy

minari = pytest.importorskip("minari")

ARMCTL = str(Path(sys.executable).parent / "armctl")
SHORT = {"max_episode_steps": 12}
CAMERA = {"resolution": (8, 6), "max_episode_steps": 6}


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    out = tmp_path_factory.mktemp("data") / "reach_ik-v0"
    return out, collect("reach_ik", episodes=7, out=out, seed=5, worlds=3)


def worlds(n=1, env="armctl/ArmReach-v0", **options):
    return make_worlds(env, n, options)


def test_a_dataset_tells_where_it_comes_from(dataset):
    out, collection = dataset
    opened = minari.MinariDataset(out / "data")
    assert (opened.total_episodes, opened.total_steps) == (7, collection.steps)
    metadata = opened.storage.metadata
    assert metadata["algorithm_name"] == "reach_ik"
    assert metadata["seed"] == 5
    assert metadata["outcomes"] == {"reached": 7}
    assert metadata["successes"] == collection.successes == 7
    assert {"armctl-suite", "mujoco", "minari"} <= set(metadata["versions"])
    for number, facts in enumerate(opened.storage.get_episode_metadata(range(7))):
        assert (facts["seed"], facts["options"]["episode"], facts["outcome"]) == (5, number, "reached")
        assert facts["success"]


def test_minari_finds_it_by_its_name_and_makes_its_environment(dataset, monkeypatch):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(dataset[0].parent))
    opened = minari.load_dataset("reach_ik-v0")
    assert opened.recover_environment().observation_space == opened.observation_space
    assert len(read_demonstrations("reach_ik-v0", worlds())) == 7


def test_the_actions_played_again_give_the_same_episode_to_the_last_bit(dataset):
    env = worlds()
    for number, episode in enumerate(read_demonstrations(dataset[0], env)):
        observations, _ = env.reset(seed=5, options={"episode": number})
        for t, action in enumerate(episode.actions):
            np.testing.assert_array_equal(episode.observations[t], observations[0])
            observations, rewards, terminated, _, _ = env.step(action[None])
            assert rewards[0] == episode.rewards[t]
        np.testing.assert_array_equal(episode.observations[-1], observations[0])
        assert terminated[0]
        assert episode.terminated
        assert episode.success


def test_what_is_collected_does_not_depend_on_the_number_of_worlds(dataset, tmp_path):
    collect("reach_ik", episodes=7, out=tmp_path / "one", seed=5)
    for several, one in zip(
        *(read_demonstrations(out, worlds()) for out in (dataset[0], tmp_path / "one")), strict=True
    ):
        np.testing.assert_array_equal(several.observations, one.observations)
        np.testing.assert_array_equal(several.actions, one.actions)


def test_failed_episodes_are_told_from_successes(tmp_path):
    collection = collect("random", episodes=5, out=tmp_path / "random", worlds=2, env_options=SHORT)
    assert (collection.successes, collection.steps) == (0, 60)
    read = read_demonstrations(tmp_path / "random", worlds())
    assert not any(episode.success or episode.terminated for episode in read)


@pytest.mark.slow
@pytest.mark.parametrize("camera", ["depth", "classes"])
def test_camera_observations_are_kept_exactly(camera, tmp_path):
    options = {**CAMERA, "camera": camera}
    collect("bridge_ompl", "armctl/BridgeCross-v0", episodes=3, out=tmp_path / "d", worlds=2, env_options=options)
    env = worlds(env="armctl/BridgeCross-v0", **options)
    for number, episode in enumerate(read_demonstrations(tmp_path / "d", env)):
        observations, _ = env.reset(seed=0, options={"episode": number})
        seen: Any = episode.observations
        for name in ("image", "motion"):
            np.testing.assert_array_equal(seen[name][0], observations[name][0])
        assert seen["image"].shape == (7, 6, 8)


def test_what_is_done_instead_is_not_what_is_recorded():
    env = worlds(2, **SHORT)
    still = lambda observations, labels: observations[:, 3:9]  # noqa: E731
    for _, episode in demonstrate(make_policy("reach_ik", env), env, 4, 0, acting=still):
        joints = episode.observations[:, 3:9]
        np.testing.assert_allclose(joints, joints[:1].repeat(len(joints), 0), atol=0.02)
        assert np.abs(episode.actions - joints[:-1]).max() > 0.05


def test_a_failing_policy_keeps_what_was_finished(tmp_path):
    def failing(env):
        policy: Any = make_policy("random", env)
        policy.decisions = 0
        plain = policy.act

        def act(observations):
            policy.decisions += 1
            if policy.decisions > 30:
                raise ZeroDivisionError("tired")
            return plain(observations)

        policy.act = act
        return policy

    with pytest.raises(PolicyFailed, match="tired"):
        collect(failing, episodes=9, out=tmp_path / "d", env_options=SHORT)
    assert len(read_demonstrations(tmp_path / "d", worlds())) == 2
    with pytest.raises(PolicyFailed):
        collect(failing, episodes=9, out=tmp_path / "none", env_options={"max_episode_steps": 40})
    assert not (tmp_path / "none/data").exists()


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"policy": "reach_ki"}, "Did you mean 'reach_ik'"),
        ({"env": "armctl/Nothing-v0"}, "ArmReach"),
        ({"env_options": {"robto": "ur3"}}, "Did you mean 'robot'"),
        ({"episodes": 0}, "at least 1"),
        ({"seed": -1}, "whole number"),
    ],
)
def test_mistakes_write_nothing(change, says, tmp_path):
    with pytest.raises(ConfigurationError, match=says):
        collect(**{"policy": "random", "episodes": 1, "out": tmp_path / "d", **change})
    assert not (tmp_path / "d").exists()


def test_a_dataset_is_not_overwritten_and_a_place_that_cannot_be_written_is_told(dataset):
    before = (dataset[0] / "data" / "metadata.json").read_bytes()
    with pytest.raises(ResultsError, match="holds a dataset, of 7 episodes, not 1"):
        collect("random", episodes=1, out=dataset[0])
    assert (dataset[0] / "data" / "metadata.json").read_bytes() == before
    with pytest.raises(ResultsError, match=r"(cannot|could not) be written"):
        collect("random", episodes=1, out="/proc/nowhere")


def test_without_minari_it_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(ConfigurationError, match=r"armctl-suite\[rl\]"):
        collect("random", episodes=1, out=tmp_path / "d")


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"robot": "panda"}, r"observations \[12\] and actions \[6\]; here they are \[13\]"),
        ({"control": "delta"}, "control 'position', but here control is 'delta'"),
        ({"robot": "ur10"}, "robot 'ur5'"),
    ],
)
def test_a_dataset_of_something_else_is_refused(dataset, options, says):
    with pytest.raises(ConfigurationError, match=says):
        read_demonstrations(dataset[0], worlds(**options))


def test_any_minari_dataset_that_fits_is_read(tmp_path, monkeypatch):
    from minari.data_collector import EpisodeBuffer

    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    env = worlds()
    rng = np.random.default_rng(0)
    buffer = EpisodeBuffer(
        observations=rng.normal(size=(4, 12)).astype(np.float32), actions=rng.normal(size=(3, 6)).astype(np.float32),
        rewards=[0.0] * 3, terminations=[False] * 3, truncations=[False, False, True], infos={},
    )  # fmt: skip
    spaces = {"observation_space": env.single_observation_space, "action_space": env.single_action_space}
    with pytest.warns(UserWarning, match="env_spec is None"):
        minari.create_dataset_from_buffers("foreign-v0", [buffer, buffer], **spaces)
    first, _ = read_demonstrations("foreign-v0", env)
    np.testing.assert_array_equal(first.observations, buffer.observations)
    np.testing.assert_array_equal(first.actions, buffer.actions)
    assert first.success  # nothing tells otherwise


def without_checksums(data):
    """Make a dataset one that armctl has not written."""
    metadata = json.loads((data / "metadata.json").read_text())
    del metadata["checksum"], metadata["sha256"]
    (data / "metadata.json").write_text(json.dumps(metadata))


def _cut(data):
    file = data / "main_data.hdf5"
    file.write_bytes(file.read_bytes()[:1000])


def _no_spaces(data):
    metadata = json.loads((data / "metadata.json").read_text())
    del metadata["observation_space"]
    (data / "metadata.json").write_text(json.dumps(metadata))


def _edit(change):
    def edit(data):
        import h5py

        with h5py.File(data / "main_data.hdf5", "a") as file:
            change(file["episode_1"])

    return edit


def _not_finite(episode):
    episode["actions"][0] = np.nan


def _too_short(episode):
    episode["observations"].resize(2, axis=0)


@pytest.mark.parametrize(
    ("damage", "says"),
    [
        (_cut, "not a readable Minari dataset"),
        (_no_spaces, "does not declare"),
        (lambda data: (data / "metadata.json").write_text("{"), "not a readable Minari dataset"),
        (lambda data: (data / "metadata.json").write_text("[]"), "does not declare"),
        (lambda data: (data / "metadata.json").write_text("[" * 100_000), "not a readable Minari dataset"),
        (lambda data: (data / "main_data.hdf5").unlink(), "there is no file"),
        (lambda data: (data / "metadata.json").unlink(), "there is no Minari dataset"),
        (_edit(lambda episode: episode.pop("actions")), "episode_1 has no actions"),
        (_edit(_not_finite), "actions of episode_1 .* not finite"),
        (_edit(_too_short), "observations of episode_1 is incomplete"),
    ],
)
def test_a_corrupt_dataset_gets_one_clear_error(dataset, damage, says, tmp_path):
    copied = tmp_path / "data"
    copied.mkdir()
    for file in (dataset[0] / "data").iterdir():
        (copied / file.name).write_bytes(file.read_bytes())
    without_checksums(copied)
    damage(copied)
    with pytest.raises(ConfigurationError, match=says):
        read_demonstrations(tmp_path, worlds())
