"""Random command lines of all verbs: each works, or is refused in words; never a traceback."""

import json
import os
import shutil
import socket
from pathlib import Path

import pytest

from armctl.core.console import CONTROLS
from armctl.policies.trainings import card_path

from ..command_line import armctl
from .child import Child
from .mutation import outcomes_of

VERBS = ["compare", "sweep", "suite", "report", "reproduce", "run", "view", "collect", "train", "export", "list"]
QUICK = ["reproduce", "run", "collect", "export", "list"]
"""Those that play, report or train little."""
HOSTILE = [
    "", " ", "[red]", "[/]", "[/red]x[", "[bold](x)[link=x]", "x" * 300, "x" * 5_000, "\x1b[2J\x1b]0;x\x07",
    "a\nb\r\tc", "\u202etxt", "\udcff\udcfe", "ÄÖ工", "-", "--", "-x", "--nope", "--help", "..", "../../..", "/",
    "/dev/null", "/dev/zero", "/proc/self/mem", "/proc/1", "~", "*", "%s%n", "{}", "{0}", "$(x)", "a=b", "=", "'",
    '"', "\\", "@x", "nan", "inf", "-inf", "1e400", "-1", "0", "1_0", "9" * 30, "9" * 5_000, "0x10", "1.5", "٣",
    "None", "True", "file", "loop", "pipe", "broken.py", "folder.py", "results", "swept", "agent.json", "agent.onnx",
    "recipe.toml", "bad.toml", "model.zip",
]  # fmt: skip
CODE = [
    ":", "a:", ":b", "a:b:c", "::", "..py:x", ".py:x", "broken.py:x", "broken:x", "exits.py:x", "exits:x", "exits:",
    "quits.py:x", "interrupts.py:x", "fails.py:x", "folder.py:x", "folder:x", "missing.py:x", "odd.py:none",
    "odd.py:number", "odd.py:Empty", "odd.py:nothing", "odd.py:many", "odd.py:Fails", "odd.py:fails", "odd.py:quits",
    "odd.py:[red]", "odd.py:", "json:loads", "os:_exit", "sys:exit", "sys.py:exit", "..:x", ".:x", "a..b:x", "loop:x",
    "/:x", "/dev/null:x", "odd.py:odd", "odd:Empty", "pipe.py:x", "\x1b[2J:x", "[/]:x", "[/].py:x", "\udcff:x",
    "a b:x", "json:", "builtins:print", "builtins:object", "gymnasium:Env",
]  # fmt: skip
VALUES = [
    "nan", "inf", "-inf", "1e400", "-1e400", "1e-400", "9" * 30, "-" + "9" * 5_000, "[]", "()", "{}", "{1}",
    "{'a': 1}", "[[1, 2], 3]", "(" * 1_000, "[" * 1_000 + "]" * 1_000, "-" * 3_000 + "1", "1" + "+1" * 3_000, "'",
    '"""', "b'x'", "'a\\x00b'", "'\\ud800'", "1j", "None", "True", "False", "...", "[None]", "(1,)", "(0, 0)",
    "(-1, 5)", "(10**9,)", "0", "-1", "1", "2", "0.5", "1e9", "10_0", "{'payload': 2}", "{'payload': nan}",
    "{'noise': 'x'}", "{'nope': 1}", "{5: 5}", "{'delay': 10**30}", "{'payload': None}",
]  # fmt: skip
ENVS = [
    "armctl/ArmReach-v0", "ArmReach-v0", "armctl/ArmReachObstacles-v0", "armctl/ArmReachMoving-v0",
    "armctl/BridgeCross-v0", "armctl/BridgeCrossMoving-v0", "Pendulum-v1", "CartPole-v1", "FrozenLake-v1",
    "odd.py:Still", "armctl/ArmReech-v0",
]  # fmt: skip
SMALL = ["CartPole-v1", "FrozenLake-v1", "odd.py:Still", "armctl/ArmReech-v0"]
"""Environments of few and short episodes."""
POLICIES = ["random", "reach_ik", "reach_ppo", "bridge_ppo", "moving_ppo", "agent.json", "odd.py:still", "rndom"]
DISTURBANCES = ["noise", "delay", "payload", "friction", "strength", "pushes", "mismatch", "dropout"]
LEVELS = [
    "", "=", "=0", "=1", "=0,1", "=nan", "=inf", "=1e400", "=-1", "=x", "=,", "=1,,2", "=[1]", "=1;2",
    "=" + "1," * 500, "=None",
]  # fmt: skip
OUTS = [
    "new", "new/deeper", "results", "swept", "file", "file/inside", "loop", "loop/x", "pipe", "", ".", "a\nb",
    "[red]", "[/]", "\x1b[2J",
]  # fmt: skip
SETTINGS = [
    "max_episode_steps", "robot", "control", "target", "target_box", "tolerance", "observation", "resolution",
    "disturbances", "deck_length", "walkers", "success_return", "render_mode", "num_envs", "wrappers",
    "vector_kwargs", "task", "id", "g", "spec", "self", "kwargs", "obstacles", "reward_weights", "urdf", "tip",
    "natural", "map_name", "is_slippery", "seed", "threads",
]  # fmt: skip
ODD = """
import gymnasium, numpy as np, sys
none, number = None, 5
def nothing(): pass
def many(a, b, c): pass
def fails(observation): raise RuntimeError("[/] \\x1b[2J")
def quits(observation): sys.exit(5)
def still(observation): return observation[3:9]
class Empty: pass
class Fails:
    def __init__(self): raise RuntimeError("[red]")
class Still(gymnasium.Env):
    observation_space = gymnasium.spaces.Box(-1, 1, (9,)); action_space = gymnasium.spaces.Box(-1, 1, (6,))
    def __init__(self, size=1, render_mode=None): pass
    def reset(self, seed=None, options=None): return np.zeros(9, np.float32), {}
    def step(self, action): return np.zeros(9, np.float32), 0.0, True, False, {}
"""
HERE = Path(__file__).parent
SHORT = ["--set", "max_episode_steps=2"]


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    """A folder with results, an agent, recipes, hostile modules and odd files."""
    home = tmp_path_factory.mktemp("home")
    armctl("compare", "random", "reach_ppo", "--episodes", "2", "--out", "results", *SHORT, cwd=home)
    armctl("sweep", "random", "--episodes", "2", "--disturbance", "delay=1", "--out", "swept", *SHORT, cwd=home)
    for suffix in (".json", ".onnx"):
        shutil.copy(card_path("reach_ppo").with_suffix(suffix), home / f"agent{suffix}")
    card = json.loads((home / "agent.json").read_text())
    card["evaluation"]["episodes"] = 2  # so that it is soon reproduced
    texts = {
        "agent.json": json.dumps(card),
        "odd.py": ODD, "broken.py": "def f(:\n", "exits.py": "raise SystemExit('[/]')",
        "quits.py": "import sys; sys.exit(17)", "interrupts.py": "raise KeyboardInterrupt",
        "fails.py": "raise RuntimeError('[/] \\x1b[2J')", "file": "in the way",
        "recipe.toml": 'learner = "ppo"\nenv = "armctl/ArmReach-v0"\n', "bad.toml": "[[", "model.zip": "PK",
        "trials.csv": "who,env,n,did,got,s,k,light,training_seed,layout\n"
        + "".join(f"{name},a,{i},{i % 2},{i},{i},{i},dim,0,{i}\n" for name in ("old", "new") for i in range(12)),
    }  # fmt: skip
    for name, text in texts.items():
        (home / name).write_text(text)
    (home / "folder.py").mkdir()
    (home / "loop").symlink_to("loop")
    os.mkfifo(home / "pipe")
    os.mkfifo(home / "pipe.py")
    return home


@pytest.fixture(scope="module")
def run(home):
    """Run a command line in a copy of the folder, so that none depends on another."""
    child = Child(HERE / "run_command_line.py")
    copy = home.with_name("copy")

    def run_words(words):
        copied(home, copy)
        line = copy / "line.json"
        line.write_text(json.dumps(words))
        _, answer = child(line)
        status, out, err = json.loads(answer)
        said = f"{words}: {status}\n{out}\n{err}"
        assert status in (0, 1, 2, 130), said
        assert "Traceback" not in out + err, said
        assert status in (0, 130) or (out + err).strip(), said  # an interrupt needs no words
        assert "Usage: " in err or not CONTROLS.search(out + err), said  # Typer repeats what one has typed oneself
        return ("fine" if status == 0 else "refused"), said

    yield run_words
    child.close()


def copied(home, copy):
    shutil.rmtree(copy, ignore_errors=True)
    copy.mkdir()
    for path in home.iterdir():
        if path.is_fifo():
            os.mkfifo(copy / path.name)
        elif path.is_symlink():
            (copy / path.name).symlink_to(os.readlink(path))
        elif path.is_dir():
            shutil.copytree(path, copy / path.name)
        else:
            shutil.copy(path, copy / path.name)


@pytest.fixture(scope="module")
def taken_port():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        yield str(taken.getsockname()[1])


def words_of(verb, port, rng):
    """A command line that is more often right than wrong in each of its words, and ends soon."""

    def one(right, wrong=HOSTILE, share=0.9):
        return rng.choice(right if rng.random() < share else wrong)

    def setting():
        name = one(SETTINGS, HOSTILE, 0.9)
        return "--set", one([f"{name}={one(VALUES, HOSTILE, 0.95)}"], [name, *HOSTILE], 0.95)

    def number(*right):
        return one(right, ["-1", "0", "9" * 30, "nan"])

    envs, policies = lambda: one(ENVS, [*CODE, *HOSTILE]), lambda: one(POLICIES, [*CODE, *HOSTILE])
    seed = lambda: ("--seed", number("0", "7", str(2**63 - 1), str(2**63), str(10**9)))  # noqa: E731
    out = lambda: ("--out", one(OUTS, HOSTILE, 0.9))  # noqa: E731
    env, flag = lambda: ("--env", envs()), lambda *names: lambda: (rng.choice(names),)
    formats = lambda: ("--format", one(["json", "csv", "latex", "markdown", "table"]))  # noqa: E731
    worlds, workers = lambda: ("--worlds", number("1", "3")), lambda: ("--workers", number("1"))
    level = lambda: ("--disturbance", one(DISTURBANCES) + one(LEVELS, HOSTILE, 0.9))  # noqa: E731
    shared = [env, env, seed, setting]
    options = {
        "compare": [*shared, out, flag("--overwrite"), worlds, workers, formats],
        "sweep": [*shared, out, level, level, flag("--overwrite"), worlds, formats],
        "suite": [seed, out, flag("--overwrite"), flag("--quick"), worlds, workers, formats],
        "report": [out, env, lambda: ("--policy", policies()), flag("--no-video")],
        "reproduce": [env, seed, worlds, formats],
        "run": [*shared, lambda: ("--episode", number("0", "7")), lambda: ("--video", one(OUTS))],
        "view": [*shared, lambda: ("--episode", number("0", "7")), flag("--native", "--no-open")],
        "collect": [*shared, out, worlds, flag("--overwrite")],
        "train": [
            *shared, out, lambda: ("--shaping", one(["ik", "distance", "none"])), lambda: ("--teacher", policies()),
            lambda: ("--shaping-scale", number("1", "0.5")), flag("--resume"),
            lambda: ("--option", f"{one(['gamma', 'learning_rate', 'features', 'batch_size', 'nope'])}={one(VALUES)}"),
        ],
        "export": [
            *shared, out, lambda: ("--vecnormalize", one(OUTS)), lambda: ("--algorithm", one(["ppo", "x"])),
            flag("--trust"),
        ],
        "list": [env],
    }[verb]  # fmt: skip
    words = {
        "report": lambda: [one(["results", "swept"])],
        "reproduce": lambda: [one(["agent.json", "agent.onnx", "nope", "random", "reach_ik"])],
        "train": lambda: [one(["ppo", "sac", "bc", "reach_ppo", "recipe.toml", "bad.toml"])],
        "export": lambda: [one(["model.zip", "agent.onnx", "file"])],
        "suite": list,
        "list": list,
    }.get(verb, lambda: [policies() for _ in range(rng.choice([1, 1, 2]) if verb in ("compare", "sweep") else 1)])()
    for _ in range(rng.randint(0, 4)):
        words += rng.choice(options)()
    if rng.random() < 0.05:
        words.insert(rng.randint(0, len(words)), rng.choice([*HOSTILE, *CODE]))
    ending = {
        "compare": ["--episodes", number("1", "2"), *SHORT],
        "sweep": ["--episodes", number("1"), "--disturbance", "delay=1", *SHORT],
        "suite": ["--env", one(SMALL, [*CODE, *HOSTILE], 0.6), "--episodes", number("1")],
        "report": ["--no-video"],
        "run": ["--episodes", one(["2"], ["0", "x"]), "--steps", one(["1", "2"], ["0", "nan"])],
        "view": ["--port", one([port], ["-1", "65536", "x", ""])],
        "collect": ["--out", one(OUTS), "--episodes", number("1", "2"), *SHORT],
        "train": ["--steps", "1", *SHORT, "--out", "file/inside"],
    }.get(verb, [])  # fmt: skip
    return [verb, *words, *ending]


def outcomes(run, verb, port, count):
    return outcomes_of(run, lambda run, rng: run(words_of(verb, port, rng)), count)


@pytest.mark.slow
@pytest.mark.parametrize(
    "verb",
    [verb if verb in QUICK else pytest.param(verb, marks=pytest.mark.slow) for verb in VERBS],
)
def test_a_random_command_line_works_or_is_refused(run, taken_port, verb):
    assert "refused" in outcomes(run, verb, taken_port, 6)


@pytest.mark.thorough
@pytest.mark.parametrize("verb", VERBS)
def test_two_thousand_random_command_lines_work_or_are_refused(run, taken_port, verb):
    assert "refused" in outcomes(run, verb, taken_port, 200)
