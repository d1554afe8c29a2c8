"""Valid command lines of which one part is changed: each works, or is refused in words; never a traceback."""

import io
import random
import sys
from typing import Any

import pytest
import typer
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from armctl.cli import app
from armctl.core.console import CONTROLS

from ..command_line import armctl
from ..fuzz.test_command_lines import CODE, HOSTILE, VALUES, copied, home  # noqa: F401 - a fixture

ENDS_THE_PROCESS = {"os:_exit"}
WRONG = [word for word in (*HOSTILE, *CODE, *VALUES) if word not in ENDS_THE_PROCESS]
NUMBERS = [
    "-1",
    "0",
    "1",
    "2",
    "3",
    "0.5",
    "-0.0",
    "1e400",
    "1e-400",
    "nan",
    "-inf",
    "9" * 30,
    "9" * 400,
    "1_0",
    "٣",
    " 1",
    "0x1",
]
ARM, ODD = ("--env", "armctl/ArmReach-v0"), ("--env", "odd.py:Still")
SHORT = ("--set", "max_episode_steps=2")
FORMATS = [("--format", name) for name in ("table", "json", "csv", "latex", "markdown")]
POLICY_SEEDS = [("--policy-seed", text) for text in ("0", "7", str(2**127))]
SEEDS = [("--seed", "0"), ("--seed", "7"), ("--seed", str(10**8 - 1))]
WORLDS, WORKERS = [("--worlds", "1"), ("--worlds", "3")], [("--workers", "1"), ("--on", "local")]
ISOLATED, EARLY = [("--isolate",), ("--isolate", "--timeout", "60")], [("--until", "decided", "--at-most", "3")]
FILTERED = [("--filter",)]
SCORED = [("--success-return", "-1"), ("--success", "any"), ("--success-key", "solved")]
OUT = [("--out", "new"), ("--out", "new/deeper"), ("--out", "results", "--overwrite")]
ROBOTS = [("--robot", "ur5"), ("--robot", "ur10")]
OPTIONS = [("--set", "tolerance=0.1"), ("--set", "control=position"), ("--set", "render_mode=rgb_array")]
PLAYED = [SEEDS, OUT, WORLDS, WORKERS, POLICY_SEEDS, FORMATS, [*ROBOTS, *OPTIONS]]
DISTURBED = [("--disturbance", "delay=1"), ("--disturbance", "payload=0,2")]
LINES: dict[str, Any] = {
    "list": ([], [[ARM, ODD], ROBOTS, [("--tip", "tool0")], [("--policy", "reach_mpc")]]),
    "new": ([("task", "mine")], []),
    "compare": (
        [("random", "odd.py:still"), ("--episodes", "1"), ARM, SHORT],
        [*PLAYED, [("--baseline", "random")], [("--margin", "2")], [("--report",)], SCORED,
         [("--return-bounds", "-9", "9")], [("--real-time", "0.01"), ("--slow-down", "1")],
         EARLY, ISOLATED, FILTERED],
    ),
    "sweep": (
        [("random",), ("--episodes", "1"), ARM, SHORT, ("--disturbance", "delay=1")],
        [*PLAYED, DISTURBED, SCORED, [("--return-bounds", "-9", "9")],
         [("--slow-down", "1"), ("--slow-down", "1", "--real-time", "1")], EARLY, ISOLATED, FILTERED,
         [("--pairs", "delay,payload"), ("--pairs", "delay=1,payload=2,3")]],
    ),
    "worst-case": (
        [("random",), ("--budget", "50"), ("--episodes", "1"), ARM, SHORT, ("--disturbances", "payload"),
         ("--no-video",)],
        [*PLAYED, [("--judge-seed", "99")], SCORED, ISOLATED, FILTERED],
    ),
    "plan": (
        [("--detect", "10")],
        [[("--power", "0.9")], [("--pairs", "3")], [("--unpaired",)], [("--pilot", "results")], FORMATS],
    ),
    "report": (
        [("results",), ("--no-video",)],
        [[("--out", "new.html")], [ARM, ODD], [("--policy", "odd.py:still"), ("--policy", "random")]],
    ),
    "episodes": ([("results",), ("--csv",)], [[("--parquet",)]]),
    "reproduce": ([("agent.json",)], [SEEDS, WORLDS, [ARM, ODD], FORMATS]),
    "export": (
        [("model.zip",), ("--env", "CartPole-v1")],
        [[("--out", "new.onnx")], [("--trust",)], [("--overwrite",)], [("--algorithm", "ppo")], [*ROBOTS, *OPTIONS],
         [("--vecnormalize", "none"), ("--vecnormalize", "file")]],
    ),
    "run": (
        [("random",), ARM, ("--episodes", "1"), ("--steps", "1"), SHORT],
        [SEEDS, POLICY_SEEDS, [("--episode", "3")], [*ROBOTS, *OPTIONS]],
    ),
    "collect": (
        [("random",), ("--out", "data"), ARM, ("--episodes", "1"), SHORT],
        [SEEDS, WORLDS, WORKERS, POLICY_SEEDS, [("--format", "minari")], [("--overwrite",)], [*ROBOTS, *OPTIONS]],
    ),
    "push": (
        [("agent.json",), ("owner/name",)], [[("--private",)], [("--message", "a new one")], [("--licence", "mit")]],
    ),
    "judge": (
        [("trials.csv",), ("--policy-column", "who"), ("--success-column", "did")],
        [OUT, FORMATS, [("--baseline", "old"), ("--baseline", "new", "--fail-if", "worse")], [("--margin", "10")],
         [("--learned", "new")], [("--unpaired",), ("--any-number", "--policies-in-columns")],
         [("--success-return", "3")], [("--time-limit", "30")],
         [("--badge",)], [("--return-bounds", "0", "30")], [("--max-steps", "30")], [("--return-column", "got")],
         [("--time-column", "s")], [("--steps-column", "k")], [("--episode-column", "n")],
         [("--seed-column", "layout")], [("--task-column", "env")], [("--condition-column", "light")],
         [("--training-seed-column", "training_seed")]],
    ),
    "log": (
        [("new.csv", "old", "new")],
        [SEEDS, [("--episodes", "2")], [("--task", "bench")], [("--blind",), ("--blind", "--key", "key.json")],
         [("--blind",)]],
    ),
    "pull": ([("owner/name",)], [[("--out", "new")], [("--overwrite",)]]),
    "suite": (
        [ODD, ("--episodes", "1")],
        [[("--quick",)], [("--policy", "odd.py:still")], SEEDS, OUT, WORLDS, WORKERS, POLICY_SEEDS, FORMATS, EARLY,
         ISOLATED, FILTERED],
    ),
    "tune": (
        [("reach_mpc",), ("--trials", "1"), ("--episodes", "1"), ("--out", "new"), ARM],
        [[("--hours", "1e-9")], [("--score", "return"), ("--score", "success")], [("--training-seeds", "1")],
         [("--resume",)], SEEDS, WORKERS, FORMATS],
    ),
    "train": (
        [("recipe.toml",), ("--steps", "1"), ("--out", "file/inside")],
        [[ARM], SEEDS, [("--shaping", "ik")], [("--shaping-scale", "1.5")], [("--teacher", "reach_ik")],
         [("--option", "gamma=0.9")], [("--resume",)], [("--filter",)], [("--track", "tensorboard")],
         [("--threads", "1")], WORKERS, [*ROBOTS, *OPTIONS]],
    ),
}  # fmt: skip
"""Words of each verb's shortest line, in parts; and choices of parts that may come besides."""
REFUSED = {"push", "pull", "export", "train"}
"""Verbs whose lines are refused at last, before they ask the network or train."""
SLOW = {"suite", "train", "tune", "worst-case"}
"""Verbs of which a line takes seconds: fewer are changed."""
SERVES = {"serve", "view"}
"""Verbs that a changed line may let serve for ever: `../fuzz/test_command_lines.py` has lines of it that end."""
ELSEWHERE = {"--video", "--watch", "--rerun", "--unblind"}
"""Options that render, or open a window; and one that needs a log."""


def drawn(verb, rng):
    """A valid line, in parts."""
    shortest, choices = LINES[verb]
    chosen = rng.sample(choices, rng.randint(0 if shortest else 1, min(4, len(choices))))
    return [*shortest, *(rng.choice(options) for options in chosen)]


def mutated(parts, rng):
    """The words of a line, one part of which is changed."""
    i = rng.randrange(len(parts))
    parts, part = [list(part) for part in parts], list(parts[i])
    k = rng.randrange(len(part))
    word = part[k]
    match rng.randrange(10):
        case 0:
            del part[k]
        case 1:
            part.insert(k, rng.choice(WRONG))
        case 2:
            part += part
        case 3 if "=" in word:
            name, _, value = word.partition("=")
            part[k] = rng.choice(
                [f"{name}=", f"={value}", name, f"{name}={rng.choice(WRONG)}", f"{rng.choice(WRONG)}={value}"]
            )
        case 4:
            j = rng.randrange(len(word) + 1)
            part[k] = word[:j] + rng.choice(["", "x", "=", "\x1b", "é", " ", "\n", "-"]) + word[j + rng.randint(0, 1) :]
        case 5:
            part[k] = word.swapcase()
        case 6:
            other = rng.choice(parts)
            part[k] = rng.choice(other)
        case _:
            part[k] = rng.choice(NUMBERS if word.lstrip("-").replace(".", "").isdecimal() else WRONG)
    parts[i] = part
    return [word for part in parts for word in part]


@pytest.fixture
def run(home, monkeypatch):  # noqa: F811 - the fixture
    """Run the words in a copy of the folder, so that no line depends on another."""
    monkeypatch.setenv("HF_ENDPOINT", "http://127.0.0.1:9")
    copy = home.with_name("changed")

    def run_words(words):
        if any("\0" in word for word in words):
            return 2  # no program can be given that
        if words[0] == "run" and any(word.isdecimal() and len(word) > 20 for word in words):
            return 0  # it shows so many episodes, until it is interrupted
        copied(home, copy)
        monkeypatch.setattr(sys, "stdin", io.StringIO("y\nn 3 slow\nu\nq\n"))
        done = armctl(*words, cwd=copy, check=False)
        said = f"{words}: {done.returncode}\n{done.stdout}\n{done.stderr}"
        assert done.returncode in (0, 1, 2, 130), said
        assert "Traceback" not in done.stdout + done.stderr, said
        assert done.returncode in (0, 130) or (done.stdout + done.stderr).strip(), said
        assert "Usage: " in done.stderr or not CONTROLS.search(done.stdout + done.stderr), said
        return done.returncode

    return run_words


def test_each_option_is_drawn():
    """One that is new has a value here."""
    for verb, command in typer.main.get_command(app).commands.items():  # type: ignore[attr-defined]
        if verb in SERVES:
            continue
        shortest, choices = LINES[verb]
        words = {word for part in (*shortest, *(part for options in choices for part in options)) for word in part}
        options = {option for parameter in command.params for option in parameter.opts if option.startswith("--")}
        assert options - words <= {"--help", *ELSEWHERE}, verb


def valid_lines(run, verb, count):
    ended = [run([verb, *(word for part in drawn(verb, random.Random(k)) for word in part)]) for k in range(count)]
    played = [status for status in ended if status < 2]  # 1: an agent differs from its card
    assert verb in REFUSED or len(played) > len(ended) / 2, ended


def changed_lines(run, verb, count):
    checks = list(HealthCheck)

    @settings(max_examples=count, deadline=None, database=None, suppress_health_check=checks, derandomize=True)
    @given(st.integers(0, 2**63))
    def each(seed):
        rng = random.Random(seed)
        run([verb, *mutated(drawn(verb, rng), rng)])

    each()


@pytest.mark.slow
@pytest.mark.parametrize("verb", LINES)
def test_a_valid_line_is_mostly_fine(run, verb):
    valid_lines(run, verb, 3)


@pytest.mark.slow
@pytest.mark.parametrize("verb", LINES)
def test_a_line_with_one_part_changed_works_or_is_refused(run, verb):
    changed_lines(run, verb, 3 if verb in SLOW else 8)


@pytest.mark.thorough
@pytest.mark.parametrize("verb", LINES)
def test_many_lines_valid_and_changed(run, verb):
    valid_lines(run, verb, 8 if verb in SLOW else 20)
    changed_lines(run, verb, 25 if verb in SLOW else 100)
