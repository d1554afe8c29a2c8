"""Isolated policies play the same episodes, in processes that have nothing to cheat with, and that may die."""

import hashlib
import sys
from contextlib import closing
from typing import Any

import numpy as np
import pytest

import armctl
from armctl.core.errors import ConfigurationError, ResultsError
from armctl.core.registration import bare_id
from armctl.policies import WorldsByInterface
from armctl.rollout.construction import build_timed
from armctl.rollout.parallel import Setting, WorkerConfig, _for_sending
from armctl.study import compare
from armctl.study.results import read_comparison

from .guessing import guess_task

pytestmark = pytest.mark.slow  # interpreters are started
BRIDGE = "armctl/BridgeCrossMoving-v0"
MEASURED = {"run", "worlds", "workers", "missed_deadlines"}
CHEATS = """
import ctypes, gc, os, pickle, random, socket, sys, time
import numpy as np

ENDED = []

def environment():
    found = [o for o in gc.get_objects() if type(o).__name__ == "Guess"]
    return max(found, key=lambda env: getattr(env, "begun", 0.0), default=None)  # others may not be collected yet

def objects(observation):
    env = environment()
    return [env.drawn if env else 0.5]

def global_random(observation):
    state = np.random.get_state()
    number = np.random.random()
    np.random.set_state(state)
    return [number]

def frames(observation):
    frame = sys._getframe()
    while frame:
        for value in frame.f_locals.values():
            if hasattr(value, "_seed") and hasattr(value, "_numbers"):
                from armctl.envs import episode_seed
                seed = episode_seed(value._seed, int(value._numbers[0]))
                return [np.random.default_rng(seed).random()]
        frame = frame.f_back
    return [0.5]

def writes(observation):
    env = environment()
    if env:
        env.drawn = 0.25
    return [0.25]

def replaces(observation):
    for module in list(sys.modules.values()):
        if "Guess" in vars(module):
            module.Guess.bonus = 1.0
    return [0.5]

class Threads:
    '''Waits in a thread for the environment to be there.'''
    def __init__(self):
        import threading
        self.looks = 0
        threading.Thread(target=self.wait, daemon=True).start()
    def wait(self):
        while not ENDED:
            env = environment()
            if env and getattr(env, "steps", 0) == 1:
                env.drawn = 0.125
            self.looks += 1
            time.sleep(0.0005)
    def act(self, observation):
        looks = self.looks + 2
        while self.looks < looks:
            time.sleep(0.001)
        return [0.125]
"""
AT_IMPORT = """
import sys
for module in list(sys.modules.values()):
    if "Guess" in vars(module):
        module.Guess.bonus = 1.0

def policy(observation):
    return [0.5]
"""


@pytest.fixture
def home(tmp_path, monkeypatch):
    guess_task(tmp_path, monkeypatch)
    (tmp_path / "cheats.py").write_text(CHEATS)
    (tmp_path / "at_import.py").write_text(AT_IMPORT)
    for name in ("cheats", "at_import"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    yield tmp_path
    if "cheats" in sys.modules:
        sys.modules["cheats"].ENDED.append(True)


def played(policies, isolate, env="guess_task.py:Guess", episodes=8, **options):
    comparison = compare(policies, env, episodes=episodes, isolate=isolate, policy_seed=5, **options)
    assert not comparison.failures, comparison.failures
    return comparison


CHEATING = ["objects", "global_random", "frames", "writes", "replaces", "Threads"]


@pytest.mark.parametrize("name", CHEATING)
def test_who_cheats_wins_unless_isolated(home, name):
    cheat, episodes = f"cheats.py:{name}", 4
    (honest,) = played([cheat], isolate=True, episodes=episodes).policies
    (cheating,) = played([cheat], isolate=False, episodes=episodes).policies
    assert cheating.success.value >= 0.5
    assert honest.success.value == 0.0
    assert honest.isolated
    assert not cheating.isolated


def test_an_isolated_policys_code_is_imported_in_its_own_process_only(home):
    (honest,) = played(["at_import.py:policy"], isolate=True).policies
    assert honest.success.value == 0.0
    assert "at_import" not in sys.modules
    (cheating,) = played(["at_import.py:policy"], isolate=False).policies
    assert cheating.success.value == 1.0


def test_the_secrets_are_not_in_its_process(home):
    """Neither the seed, nor the secret of random numbers, nor a world, in no object, frame or argument."""
    options: Any = {"env": "guess_task.py:Guess", "episodes": 2, "seed": 91827364, "policy_seed": 77_665_544_332_211}
    digests = {hashlib.sha256(str(options[name]).encode()).hexdigest() for name in ("seed", "policy_seed")}
    (home / "mine.py").write_text(f"""
import gc, hashlib, re, sys

def policy(observation):
    numbers = set()
    for o in gc.get_objects():
        values = o.values() if type(o) is dict else o if type(o) in (list, tuple, set) else ()
        numbers |= {{str(value) for value in list(values) if type(value) is int}}
    frame, texts = sys._getframe(), [*sys.argv, *sys.orig_argv]
    while frame:
        texts.append(repr(frame.f_locals))
        numbers |= {{str(value) for o in frame.f_locals.values() for value in getattr(o, "__dict__", {{}}).values()}}
        frame = frame.f_back
    numbers |= set(re.findall(r"[0-9]+", str(texts)))
    found = [n for n in numbers if hashlib.sha256(n.encode()).hexdigest() in {digests}]
    worlds = sorted({{type(o).__name__ for o in gc.get_objects()}} & {{"ThirdPartyVectorEnv", "Guess", "_Player"}})
    if found or worlds:
        raise ValueError(f"found {{found}} {{worlds}}")
    return [0.5]
""")
    assert not compare(["mine.py:policy"], isolate=True, **options).failures
    failure = compare(["mine.py:policy"], **options).failures["mine.py:policy"]
    assert "91827364" in failure
    assert "Guess" in failure


LINE_UPS: list[Any] = [
    ("armctl/ArmReach-v0", ["reach_ppo", "random"], {}, {"worlds": 2, "workers": 2}),
    ("armctl/ArmReach-v0", ["reach_mpc"], {"disturbances": {"noise": 0.01, "delay": 1}}, {}),
    ("armctl/ArmReachMoving-v0", ["reach_ik", "moving_ppo"], {}, {"worlds": 2}),
    ("armctl/ArmReachObstacles-v0", ["reach_ompl", "obstacles_imagined", "obstacles_plan_bc"], {}, {"worlds": 2}),
    (BRIDGE, ["bridge_moving_state_ppo", "bridge_moving_distil", "bridge_ompl"], {}, {"worlds": 2}),
    ("Pendulum-v1", ["random"], {}, {"worlds": 2}),
]


@pytest.mark.one_case
@pytest.mark.parametrize(("env", "policies", "options", "how"), LINE_UPS, ids=[bare_id(env) for env, *_ in LINE_UPS])
def test_isolated_policies_play_the_same_episodes(env, policies, options, how):
    options = {"max_episode_steps": 30} | options
    together, apart = (played(policies, isolate, env, 4, env_options=options, **how) for isolate in (False, True))
    columns = [name for name in together.episodes if name not in MEASURED and "_ms" not in name]
    assert together.episodes[columns].equals(apart.episodes[columns])
    for policy, other in zip(together.policies, apart.policies, strict=True):
        assert other.isolated == (policy.policy != "bridge_ompl")
        assert (policy.sees, policy.training, policy.family) == (other.sees, other.training, other.family)
        assert other.decision_ms_p50 > 0


def test_who_was_isolated_is_told(tmp_path):
    policies, options = ["bridge_ompl", "bridge_moving_state_ppo"], {"max_episode_steps": 3}
    comparison = played(policies, True, BRIDGE, 10, env_options=options, worlds=10, out=tmp_path)
    text = "that got observations only: bridge_moving_state_ppo, and not bridge_ompl"
    assert text in comparison.verdict.context
    assert text in read_comparison(tmp_path).verdict.context
    (table,) = (table for table in comparison.document().tables if table.key == "policies")
    assert [record["isolated"] for record in table.records] == [False, True]
    texts = [part.text for part in comparison.document().parts if hasattr(part, "text")]
    assert sum("isolated: decision times as measured in its own process" in text for text in texts) == 1
    assert "solated" not in str(played(policies, False, BRIDGE, 10, env_options=options, worlds=10).verdict)


def test_who_sees_the_state_is_refused_unless_it_came_with_armctl(home):
    (home / "mine.py").write_text("""
import armctl

@armctl.sees("state")
def policy(env):
    return lambda observation: [0.5]
""")
    with pytest.raises(ConfigurationError, match=r"mine.py:policy sees the true state, .* cannot be isolated"):
        compare(["mine.py:policy"], "guess_task.py:Guess", episodes=1, isolate=True)


def test_a_folder_holds_isolated_episodes_only_if_it_says_so(tmp_path):
    options: Any = {"episodes": 2, "env_options": {"max_episode_steps": 3}, "out": tmp_path}
    compare(["random"], **options)
    with pytest.raises(ResultsError, match="isolated"):
        compare(["random"], **options, isolate=True)
    compare(["random"], **options, isolate=True, overwrite=True)
    again = compare(["random"], **options | {"episodes": 4}, isolate=True)
    assert again.resumed == 2


def test_own_code_is_the_same_code_for_resuming_or_it_is_refused(home):
    (home / "mine.py").write_text("def policy(observation):\n    return [0.5]\n")
    options: Any = {"env": "guess_task.py:Guess", "out": home / "out", "isolate": True}
    compare(["mine.py:policy"], episodes=2, **options)
    assert compare(["mine.py:policy"], episodes=3, **options).resumed == 2
    (home / "mine.py").write_text("def policy(observation):\n    return [0.25]\n")
    with pytest.raises(ResultsError, match=r"mine\.py"):
        compare(["mine.py:policy"], episodes=4, **options)


def test_an_isolated_policy_gets_its_map_foresight_and_random_numbers():
    @armctl.sees("map", foresight=("target", "disturbance"))
    def policy(env):
        class Telling:
            def act(self, observation):
                numbers = [env.rng().random(), env.control_step(), env.preview("disturbance")["payload"]]
                target = [] if env.preview("target") is None else env.preview("target").positions([0.1, 0.2])
                walls = [] if env.map() is None else env.map().centres
                texts = [float(np.sum(part)) for part in (numbers, target, walls, env.options.tolerance)]
                return env.idle_action + 1e-3 * np.resize(texts, env.idle_action.shape)

        return Telling()

    for env in ("armctl/ArmReachMoving-v0", "armctl/ArmReachObstacles-v0"):
        options = {"max_episode_steps": 5, "disturbances": {"payload": 1.0}}
        together, apart = (
            played({"p": policy}, isolate, env, 3, env_options=options, worlds=2) for isolate in (False, True)
        )
        for name in ("return", "path_length", "energy"):
            assert together.episodes[name].tolist() == apart.episodes[name].tolist()


def test_decision_times_are_those_of_the_policys_call(home):
    (home / "mine.py").write_text("import time\ndef policy(observation):\n    time.sleep(0.02)\n    return [0.5]\n")
    (policy,) = played(["mine.py:policy"], True, episodes=3).policies
    assert 20 <= policy.decision_ms_p50 < 40


def test_sweeps_suites_and_comparisons_that_stop_early_isolate_too(home):
    options: Any = {"isolate": True, "worlds": 10}
    words = "Isolated, each in a process of its own that got observations only: "
    swept = armctl.sweep(["reach_ik", "random"], disturbances={"payload": [2]}, episodes=10, **options,
                         env_options={"max_episode_steps": 4})  # fmt: skip
    texts = [part.text for part in swept.document().parts if hasattr(part, "text")]
    assert f"{words}reach_ik, random." in texts
    suite = armctl.suite(["BridgeCross-v0"], quick=True, episodes=3, **options | {"worlds": 3})
    assert f"{words}bridge_distil, and not bridge_ompl." in suite.verdicts[0].context
    stopped = compare(["reach_ik", "random"], episodes=40, until="decided", **options)
    assert f"{words}reach_ik, random." in stopped.verdict.context
    assert len(stopped.results) < 80


def test_modules_that_only_its_process_has_imported_are_sent_to_clusters_too(home):
    (home / "helper.py").write_text("VALUE = 0.5")
    (home / "mine.py").write_text("from helper import VALUE\ndef policy(observation):\n    return [VALUE]\n")
    names = {"mine.py:policy": "mine.py:policy"}
    with closing(WorldsByInterface("guess_task.py:Guess", 1)) as worlds:
        actor = build_timed("mine.py:policy", worlds.requested, "mine.py:policy", 5, isolate=True)[0]
        setting = Setting(WorkerConfig("guess_task.py:Guess", 1, {}, 0, 5, 2, isolate=True), names)
        _, files = _for_sending(setting, {"mine.py:policy": actor}, worlds)
    assert {"helper.py", "mine.py"} <= {file.name for file in files}
    assert "helper" not in sys.modules
