"""A policy that fails in some episodes loses exactly these, however many worlds and workers play, and plays on."""

import math
import zlib

import gymnasium
import numpy as np
import pandas as pd
import pytest

from armctl.envs import make_worlds
from armctl.episodes import PolicyFailed
from armctl.rollout import evaluate
from armctl.study import compare

from ..printed import text_of
from ..stores import timeless

ENV, EPISODES = "armctl/ArmReach-v0", 24
OPTIONS = {"max_episode_steps": 6, "tolerance": 0.9}  # so that some episodes are won by standing still
SETTINGS = {"one world": (1, 1), "seven worlds": (7, 1), "two workers": (3, 2)}


def failing_step(observation):
    """The step in which a policy fails, by the first observation of an episode; none in most."""
    number = zlib.crc32(np.ascontiguousarray(observation).tobytes())
    return (0, 0, 1, 2, 4)[number % 5] if number % 3 == 0 else None


def fail(kind):
    """An error, or an invalid action."""
    if kind == 0:
        raise RuntimeError("out of ideas")
    if kind == 1:
        raise SystemExit(3)
    return np.full(6, math.nan) if kind == 2 else np.zeros(5)


class Moody:
    """Holds still. In some episodes it fails, in a reset or in any step."""

    def __init__(self):
        self.step = None

    def reset(self):
        self.step = 0

    def act(self, observation):
        if self.step == 0:
            self.fails_in = failing_step(observation)
        if self.fails_in is not None and self.step >= self.fails_in:
            return fail(self.fails_in % 4)
        self.step += 1
        return observation[3:9]


class MoodyBatch:
    """The same for all worlds at once, so that nobody sees which of them it is."""

    sees, training_steps = "observation", 0

    def __init__(self, n):
        self.alone = [Moody() for _ in range(n)]

    def reset(self, ids):
        for i in ids:
            self.alone[i].reset()

    def act(self, observations):
        return np.array([one.act(seen) for one, seen in zip(self.alone, observations, strict=True)])


def moody_batch(env):
    return MoodyBatch(env.num_envs)


def still(observation):
    return observation[3:9]


@pytest.fixture(scope="module")
def lost():
    """The episodes in which a moody policy fails, and the steps before: those that do not end before that."""
    worlds = make_worlds(ENV, EPISODES, OPTIONS)
    seen, _ = worlds.reset(seed=[0] * EPISODES, options={"episode": list(range(EPISODES))})
    worlds.close()
    lengths = evaluate(still, ENV, episodes=EPISODES, env_options=OPTIONS, worlds=EPISODES).length
    steps = {k: failing_step(seen[k]) for k in range(EPISODES)}
    return {k: step for k, step in steps.items() if step is not None and step < lengths[k]}


@pytest.mark.one_case
@pytest.mark.parametrize(
    ("policy", "setting"),
    [
        (Moody, "seven worlds"),
        (moody_batch, "seven worlds"),
        pytest.param(Moody, "two workers", marks=pytest.mark.slow),
        pytest.param(moody_batch, "two workers", marks=pytest.mark.slow),
    ],
)
def test_exactly_the_episodes_in_which_a_policy_fails_are_lost(tmp_path, lost, policy, setting):
    tables = {}
    for name in ("one world", setting):
        worlds, workers = SETTINGS[name]
        found = compare(
            {"moody": policy, "still": still}, ENV, episodes=EPISODES, env_options=OPTIONS, worlds=worlds,
            workers=workers, out=tmp_path / name
        )  # fmt: skip
        tables[name] = timeless(tmp_path / name)
        assert f"in {len(lost)} of {EPISODES} episodes" in found.failures["moody"]
        assert f"episode {min(lost)}" in found.failures["moody"]
        moody, other = found.policies
        assert moody.outcomes["error"] == len(lost)
        assert moody.episodes == EPISODES
        own = found.episodes[found.episodes.policy == "moody"].set_index("episode")
        other_won = found.episodes[found.episodes.policy == "still"].set_index("episode").success.astype(bool)
        assert own.index[own.outcome == "error"].tolist() == sorted(lost)
        assert own.length[sorted(lost)].tolist() == [lost[k] for k in sorted(lost)]
        won = other_won & ~other_won.index.isin(lost)
        pd.testing.assert_series_equal(own.success.astype(bool), won, check_names=False)
        assert moody.success.value == pytest.approx(won.mean())
        assert 0 < moody.success.value < other.success.value
        assert moody.restricted_steps.value >= other.restricted_steps.value
        assert found.differences[0].only_b == int((other_won & ~won).sum())
    first, *others = tables.values()
    assert len(lost) > 4
    for table in others:
        pd.testing.assert_frame_equal(table, first, check_exact=True)


def test_failing_episodes_are_finished_and_are_not_played_again(tmp_path, lost):
    first = compare({"moody": Moody}, ENV, episodes=10, env_options=OPTIONS, out=tmp_path)
    again = compare({"moody": Moody}, ENV, episodes=EPISODES, env_options=OPTIONS, out=tmp_path)
    assert again.resumed == 10
    pd.testing.assert_frame_equal(again.episodes.head(10), first.episodes)
    once_more = compare({"moody": Moody}, ENV, episodes=EPISODES, env_options=OPTIONS, out=tmp_path)
    assert once_more.resumed == EPISODES
    assert f"in {len(lost)} of {EPISODES} episodes" in once_more.failures["moody"]
    assert once_more.policies[0].outcomes == again.policies[0].outcomes


def test_a_crash_never_pays():
    """Who ends each episode before it costs anything has the least possible return."""

    class Coward:
        def __init__(self):
            self.steps = 0

        def reset(self):
            self.steps = 0

        def act(self, observation):
            self.steps += 1
            return observation[3:9] if self.steps == 1 else fail(0)

    options = OPTIONS | {"max_episode_steps": 20}
    found = compare({"coward": Coward, "still": still}, ENV, episodes=8, env_options=options)
    coward, honest = found.policies
    earned = found.episodes.groupby("policy")["return"].mean()
    assert earned["coward"] > earned["still"]
    assert coward.episode_return.value <= honest.episode_return.value
    assert found.differences[0].return_difference.value <= 0
    assert found.differences[0].superiority.probability.value <= 0.5


@pytest.mark.parametrize(("worlds", "workers"), [(1, 1), (3, 1)])
def test_a_policy_that_cannot_play_at_all_stops_at_once(worlds, workers):
    asked = []

    def at_a_loss(observation):
        asked.append(1)
        return observation["image"]

    found = compare(
        {"at_a_loss": at_a_loss, "still": still}, ENV, episodes=40, worlds=worlds, workers=workers,
        env_options=OPTIONS
    )  # fmt: skip
    assert found.failures["at_a_loss"].startswith("at_a_loss failed in episode 0: IndexError")
    assert "IndexError" in found.tracebacks["at_a_loss"]
    assert [one.policy for one in found.policies] == ["still"]
    assert len(asked) <= 3 * worlds
    with pytest.raises(PolicyFailed, match="at_a_loss failed in episode 0: IndexError"):
        evaluate(at_a_loss, ENV, episodes=4, env_options=OPTIONS)


def test_a_batch_that_acts_otherwise_when_it_is_played_again_gains_nothing_by_it():
    class Gambler:
        """Fails when it is about to lose, and hopes for better luck."""

        sees, training_steps = "observation", 0

        def __init__(self):
            self.luck = np.random.default_rng(0)

        def reset(self, ids):
            self.steps = 0

        def act(self, observations):
            self.steps += 1
            if self.steps == 3 and self.luck.random() < 0.5:
                raise RuntimeError("bad luck")
            return observations[:, 3:9] + self.luck.normal(scale=1e-3, size=(len(observations), 6))

    options = {"max_episode_steps": 6}
    found = compare({"gambler": lambda env: Gambler()}, ENV, episodes=8, worlds=4, env_options=options)
    errors = found.episodes[found.episodes.outcome == "error"]
    assert len(errors) >= 4
    assert set(errors.length) == {2}
    assert found.policies[0].episodes == 8
    assert "should draw them from env.rng" in found.failures["gambler"]


def test_a_failure_of_no_episode_is_told_and_counts_for_none():
    class Unplugged:
        """Fails in its fifth decision, whatever it decides about."""

        sees, training_steps, decisions = "observation", 0, 0

        def reset(self, ids):
            pass

        def act(self, observations):
            self.decisions += 1
            return fail(0) if self.decisions == 5 else observations[:, 3:9]

    options = {"max_episode_steps": 6}
    with pytest.warns(UserWarning, match="unplugged failed in 4 episodes played at once .RuntimeError: out of ideas"):
        found = compare({"unplugged": lambda env: Unplugged()}, ENV, episodes=8, worlds=4, env_options=options)
    assert found.policies[0].outcomes == {"timeout": 8}
    assert found.episodes.length.tolist() == [6] * 8


class Endless(gymnasium.Env):
    """Each step costs 1; nobody knows the possible returns, nor what a success is."""

    observation_space = gymnasium.spaces.Box(-1, 1, (1,))
    action_space = gymnasium.spaces.Box(-1, 1, (1,))

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        return self.np_random.uniform(-1, 1, 1).astype(np.float32), {}

    def step(self, action):
        self.steps += 1
        return np.zeros(1, dtype=np.float32), -1.0, self.steps >= 5, False, {}


gymnasium.register("ForFailing/Endless-v0", Endless)  # type: ignore[arg-type] # a class makes one too


def test_a_crash_does_not_pay_where_nobody_knows_the_possible_returns():
    def patient(observation):
        return np.zeros(1)

    def hasty(observation):
        return fail(0) if observation[0] > 0.3 else np.zeros(1)

    found = compare({"hasty": hasty, "patient": patient}, "ForFailing/Endless-v0", episodes=20)
    worse, better = found.policies
    errors = worse.outcomes["error"]
    assert 3 < errors < 17
    assert worse.success is None
    assert worse.episode_return is None
    assert worse.worst_decile is None
    assert better.episode_return.value == -5
    pair = found.differences[0]
    assert pair.superiority.probability.value == pytest.approx((20 - errors) / 40)
    assert math.isnan(pair.return_difference.value)
    assert pair.return_p is None
    assert "hasty earns" not in str(found.verdict)
    assert "nan" not in text_of(found)
