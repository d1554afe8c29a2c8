"""A policy's random numbers are its own in each episode of a run, and tell neither its seed nor its number."""

import gc
import json
import secrets
import types

import numpy as np
import pytest

import armctl
from armctl.core.errors import ConfigurationError, ResultsError
from armctl.envs import INTERFACES, PolicyStreams, make_worlds
from armctl.policies import make_policy
from armctl.study import suite, sweep
from armctl.study.results import read_comparison

REACH, SHORT = "ArmReach-v0", {"max_episode_steps": 3}
SEED, EPISODE = 12_345_678, 987_654
SECRET = 0x0123456789ABCDEF0123456789ABCDEF


@pytest.fixture(autouse=True)
def true_secrets(monkeypatch):
    """Other tests have the same secret in each run."""
    monkeypatch.setattr("armctl.envs.policy_seed.secrets", secrets)


class Random:
    """Draws its actions from `env.rng`, and keeps what it was told."""

    def __init__(self, env):
        self.env = env

    def act(self, observation):
        return observation[3:9] + self.env.rng().normal(size=6)


def told_in(env, sees="observation", seed=SEED, episode=EPISODE):
    """What a policy is told of an episode."""
    told, worlds = [], make_worlds(env, 1)
    with pytest.raises(ConfigurationError, match="needs act"):
        make_policy(armctl.sees(sees)(lambda env: told.append(env)), worlds)
    worlds.reset(seed=[seed], options={"episode": [episode]})
    return told[0]


def entropies(seed, episode):
    """What a generator might be seeded by, by whoever knows an episode's seed and number."""
    numbers = seed, episode
    for prefix in ((), (0,), (1,)):
        yield (*prefix, *numbers)
        yield (*prefix, *numbers[::-1])
    yield from (seed, episode, seed + episode, seed ^ episode, seed * episode, hash(numbers) % 2**64)


def search(rng, seeds, episodes):
    """The seed and number of an episode, as a policy would look for them: by the numbers that it draws."""
    state = rng.bit_generator.state["state"]
    for seed in seeds:
        for episode in episodes:
            streams = (np.random.default_rng(entropy) for entropy in entropies(seed, episode))
            own = [PolicyStreams(name, secret).generator(seed, episode) for name in ("policy", "", "Random")
                   for secret in (0, seed)]  # fmt: skip
            if any(one.bit_generator.state["state"] == state for one in (*streams, *own)):
                return seed, episode
    return None


def test_a_search_finds_what_was_seeded_in_the_open():
    """The search of the next test is one that would find something."""
    assert search(np.random.default_rng((0, 7, 3)), range(9), range(5)) == (7, 3)


@pytest.mark.parametrize("env", [REACH, "Pendulum-v1"])
def test_the_seed_is_not_found_by_a_search_that_tries_it(env):
    told = told_in(env)
    near = lambda number: range(number - 2, number + 3)  # noqa: E731
    assert search(told.rng(), near(SEED), near(EPISODE)) is None


@pytest.mark.parametrize("env", [REACH, "ArmReachObstacles-v0", "Pendulum-v1"])
@pytest.mark.parametrize("sees", INTERFACES)
def test_nothing_that_an_interface_reaches_is_the_seed_or_the_episode(env, sees):
    """Neither in attributes, nor in containers, arrays, closures or the states of generators."""
    told = told_in(env, sees)
    told.rng().random()
    waiting, seen, numbers = [told, told.rng().bit_generator.state], {}, set()
    while waiting:
        thing = waiting.pop()
        if id(thing) in seen or isinstance(thing, (type, types.ModuleType, types.FunctionType)):
            continue
        seen[id(thing)] = thing
        if isinstance(thing, (int, np.integer)):
            numbers.add(int(thing))
        elif isinstance(thing, np.ndarray) and thing.dtype.kind in "iu":
            numbers.update(thing.ravel().tolist())
        elif isinstance(thing, np.random.Generator):
            sequence = thing.bit_generator.seed_seq
            assert isinstance(sequence, np.random.SeedSequence)
            waiting += [thing.bit_generator.state, sequence.entropy]
        waiting += gc.get_referents(thing)
    assert len(seen) > 40
    assert not numbers & {SEED, EPISODE, EPISODE - 1, SEED + 1, SECRET}


def drawn(**more):
    """The actions of two policies of one class in two episodes, by name."""
    actions = {}

    def recording(name):
        def factory(env):
            rng = env.rng
            return types.SimpleNamespace(
                sees="observation", training_steps=0, reset=lambda ids: actions.setdefault(name, []).append(
                    [rng(i).random() for i in ids]
                ), act=lambda observations: observations[:, 3:9],
            )  # fmt: skip

        return factory

    armctl.compare({"a": recording("a"), "b": recording("b")}, episodes=2, env_options=SHORT, **more)
    return actions


def test_every_run_draws_others_and_a_policy_seed_repeats_them():
    first, again = drawn(policy_seed=SECRET), drawn(policy_seed=SECRET)
    assert first == again
    assert drawn() != drawn()
    assert first != drawn(policy_seed=SECRET + 1)
    numbers = np.ravel([first["a"], first["b"]])
    assert len(set(numbers)) == 4  # two policies and two episodes have streams of their own


def test_streams_are_uniform_and_unrelated():
    """Neighbouring seeds, episodes and names have nothing in common."""
    streams = [PolicyStreams(name, SECRET).generator(seed, k) for name in "ab" for seed in (0, 1) for k in (0, 1)]
    numbers = np.array([rng.random(2000) for rng in streams])
    assert abs(np.corrcoef(numbers) - np.eye(8)).max() < 0.12
    np.testing.assert_allclose(numbers.mean(axis=1), 0.5, atol=0.03)


@pytest.mark.parametrize("wrong", [-1, 2**128, 0.5, "12", True])
def test_a_policy_seed_of_another_kind_is_refused(wrong):
    with pytest.raises(ConfigurationError, match=r"policy_seed is a whole number from 0 to 2\^128 - 1"):
        armctl.evaluate("random", episodes=1, policy_seed=wrong)


@pytest.mark.slow
def test_a_folder_keeps_its_policy_seed(tmp_path):
    """Whatever plays later in it, however many worlds or workers: the same actions. Another one is refused."""
    command = {"env_options": SHORT, "out": tmp_path / "a"}
    first = armctl.compare({"mine": Random}, episodes=2, **command)
    more = armctl.compare({"mine": Random}, episodes=5, worlds=3, **command)
    assert (more.resumed, more.facts.policy_seed) == (2, first.facts.policy_seed)
    at_once = armctl.compare({"mine": Random}, episodes=5, env_options=SHORT, policy_seed=first.facts.policy_seed)
    assert more.episodes["return"].tolist() == at_once.episodes["return"].tolist()
    with pytest.raises(ResultsError, match=f"policy_seed: {first.facts.policy_seed} there, 12 here"):
        armctl.compare({"mine": Random}, episodes=5, policy_seed=12, **command)
    assert armctl.compare({"mine": Random}, episodes=5, policy_seed=first.facts.policy_seed, **command).resumed == 5
    written = json.loads((tmp_path / "a" / "summary.json").read_text())
    assert int(written["policy_seed"]) == first.facts.policy_seed == read_comparison(tmp_path / "a").facts.policy_seed
    anew = armctl.compare({"mine": Random}, episodes=2, overwrite=True, **command)
    assert anew.facts.policy_seed != first.facts.policy_seed


@pytest.mark.slow
def test_workers_draw_the_same(tmp_path):
    one = armctl.compare({"a": Random, "b": Random}, episodes=4, env_options=SHORT, policy_seed=SECRET)
    two = armctl.compare({"a": Random, "b": Random}, episodes=4, env_options=SHORT, policy_seed=SECRET, workers=2)
    assert one.episodes["return"].tolist() == two.episodes["return"].tolist()


def test_all_comparisons_of_a_sweep_have_one(tmp_path):
    swept = sweep("random", disturbances={"noise": [0, 0.02]}, episodes=1, out=tmp_path, env_options=SHORT)
    assert len({one.facts.policy_seed for one in swept.comparisons.values()}) == 1
    again = sweep("random", disturbances={"noise": [0, 0.02, 0.05]}, episodes=1, out=tmp_path, env_options=SHORT)
    assert {one.facts.policy_seed for one in again.comparisons.values()} == {
        swept.comparisons["none"].facts.policy_seed
    }
    assert not again.failures


def test_a_suite_hands_it_on():
    found = suite(["Pendulum-v1"], quick=True, episodes=1, policy_seed=SECRET)
    (swept,) = found.tasks.values()
    assert {one.facts.policy_seed for one in swept.comparisons.values()} == {SECRET}


def seeing(places):
    """A policy that notes, when it is made, which episodes there have been."""

    @armctl.sees("state")
    def factory(env):
        places.append((env.seeds.tolist(), env.episodes.tolist()))
        return types.SimpleNamespace(
            sees="state", training_steps=0, reset=lambda ids: None, act=lambda observations: observations[:, 3:9]
        )

    return factory


def test_policies_are_made_before_there_is_an_episode():
    places = []
    armctl.compare({"a": seeing(places), "b": seeing(places)}, episodes=2, seed=SEED, env_options=SHORT)
    armctl.evaluate(seeing(places), episodes=2, seed=SEED, env_options=SHORT)
    assert places == [([0], [-1])] * 3


def test_an_invalid_seed_is_refused_before_anything_is_written(tmp_path):
    with pytest.raises(ConfigurationError, match="seed"):
        armctl.compare("random", episodes=1, seed=-1, out=tmp_path / "out")
    assert not (tmp_path / "out").exists()
