"""Each example runs, and says how it did on episodes that it was not trained on; the zoo's files train agents."""

import os
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

import armctl
from armctl.core.seeds import TRAINING_SEEDS

from . import command_line

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "examples"
SCRIPTS = sorted(path.stem for path in EXAMPLES.glob("*.py") if "from held_out import" in path.read_text())
"""Those that train; `test_real_arm.py` has the others."""
STEPS = {"cleanrl_unmodified": 2_100, "sb3_sac_her": 2_100}
"""Of training: no more than 300, but to where it begins to learn."""
SECONDS = 300
ZOO = {
    "ppo": "--set actions=normalized --set control=relative --set observation=features",
    "sac": "--set actions=normalized --set control=relative --set observation=features --set goal=True",
}
"""The options that the files of `rl/zoo/` give to the environment, as `armctl export` takes them."""


def run(folder, *words):
    quick_to_compile = "--xla_backend_optimization_level=0"  # what JAX runs a few times only
    environment = os.environ | {"OMP_NUM_THREADS": "1", "COLUMNS": "100", "XLA_FLAGS": quick_to_compile}
    done = subprocess.run(
        [sys.executable, *words], cwd=folder, env=environment, capture_output=True, text=True, timeout=SECONDS
    )
    assert done.returncode == 0, done.stdout[-1000:] + done.stderr[-3000:]
    return done.stdout


@pytest.mark.slow
@pytest.mark.parametrize("name", SCRIPTS)
def test_it_runs_and_says_its_success(name, tmp_path):
    steps = str(STEPS.get(name, 300))
    printed = run(tmp_path, EXAMPLES / f"{name}.py", "--steps", steps, "--episodes", "10")
    assert re.search(r"^success on 10 held-out episodes: [\d.]+% \[[\d.]+%, [\d.]+%\]$", printed, re.MULTILINE)


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", ["SAC", "CrossQ"])
def test_other_algorithms_of_sbx(algorithm, tmp_path):
    words = ("--algorithm", algorithm, "--steps", "1040", "--episodes", "10")
    assert "success on 10 held-out episodes" in run(tmp_path, EXAMPLES / "sbx_ppo.py", *words)


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", list(ZOO))
def test_the_zoo_trains_what_becomes_an_agent(algorithm, tmp_path):
    settings, env = ROOT / "rl" / "zoo" / f"{algorithm}.yml", "armctl/ArmReach-v0"
    train = f"--algo {algorithm} --env {env} --gym-packages armctl --n-timesteps 2100 --eval-freq -1 --seed {10**9}"
    run(tmp_path, "-m", "rl_zoo3.train", *train.split(), "--conf-file", settings)
    [model] = tmp_path.glob(f"logs/{algorithm}/*/armctl-ArmReach-v0.zip")
    export = f"export {model} --env {env} {ZOO[algorithm]} --out agent.onnx --trust"
    command_line.armctl(*export.split(), cwd=tmp_path)
    played = armctl.evaluate(tmp_path / "agent.json", env, episodes=2, lower_bound_steps=False)
    assert len(played) == 2


@pytest.mark.parametrize("given", ["0", "-4", "many", "1.5", "", "1e9"])
def test_a_number_of_steps_that_is_none(given, monkeypatch, capsys):
    with pytest.raises(SystemExit) as ended:
        held_out(monkeypatch, "--steps", given)
    assert ended.value.code == 2
    assert f"argument --steps: {given!r} is not a whole number from 1 to" in capsys.readouterr().err


def test_what_is_evaluated_was_not_trained_on(monkeypatch):
    assert held_out(monkeypatch).seed == TRAINING_SEEDS
    for name in SCRIPTS:
        text = (EXAMPLES / f"{name}.py").read_text()
        assert re.search(r"seed(=given\.seed|\(given\.seed\)|={given\.seed})", text), name
        assert "report(" in text, name


def held_out(monkeypatch, *words):
    """What the examples' arguments are."""
    monkeypatch.syspath_prepend(EXAMPLES)
    monkeypatch.setattr(sys, "argv", ["example.py", *words])
    from held_out import arguments

    return arguments("An example.", steps=1_000)


@pytest.mark.parametrize("name", SCRIPTS)
def test_its_head_says_what_a_newcomer_asks(name):
    head = (EXAMPLES / f"{name}.py").read_text().split('"""')[1]
    for word in ("Library: ", "Autoreset: ", "Options: ", "EXPECTED: ", f"`python examples/{name}.py`"):
        assert word in head, word


def test_the_page_lists_every_example():
    page = (ROOT / "docs" / "your_own_learner.md").read_text()
    for name in SCRIPTS:
        assert f"(../examples/{name}.py)" in page, name
    for algorithm in ZOO:
        assert f"(../rl/zoo/{algorithm}.yml)" in page, algorithm


@pytest.mark.slow
def test_the_matrix_tries_what_it_says():
    """One learner's row: the fastest."""
    command = (ROOT / "benchmarks" / "learners.py", "--only", "Gymnasium", "--env", "armctl/ArmReach-v0")
    row = run(ROOT, *command).split("Gymnasium alone, as CleanRL")[1]
    assert row.count(" works ") == 4


def test_what_is_expected_was_measured():
    """`python benchmarks/examples.py --train` measures it; the heads of the scripts are written by hand."""
    benchmark = runpy.run_path(str(ROOT / "benchmarks" / "examples.py"))
    alone = [command for command in benchmark["TRAININGS"] if " " not in command]
    assert {Path(command).stem for command in alone} == {*SCRIPTS, *ZOO}
    for command in alone:
        if benchmark["trained"](command).empty:
            continue
        head = " ".join(benchmark["_path"](command).read_text().replace("\n#", "\n").split())
        assert f"EXPECTED: {benchmark['expected'](command)}" in head
