"""Each example runs, and says how it did on episodes that it was not trained on; the zoo's files train agents."""

import re
import runpy
import shutil
import sys
from pathlib import Path

import pytest

import armctl
from armctl.core.seeds import TRAINING_SEEDS

from . import command_line
from .page_runner import LEARNING, page_runner

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "examples"
SCRIPTS = sorted(path.stem for path in EXAMPLES.glob("*.py") if "from held_out import" in path.read_text())
"""Those that train; `test_real_arm.py` has the others."""
STEPS = {"sb3_sac_her": 2_100}
"""Of training: no more than 300, but to where it begins to learn."""
FEWER = {
    "cleanrl_unmodified": {'"--cuda=False",': '"--cuda=False", "--num-steps=128",'},
    "minari_imitation_bc": {"episodes=500": "episodes=50"},
    "one_file_ppo": {"ROLLOUT_LENGTH = 16, 128": "ROLLOUT_LENGTH = 16, 16"},
    "sb3_contrib_recurrent_ppo": {"n_steps=128": "n_steps=16"},
    "sb3_ppo": {'"n_steps": 128': '"n_steps": 16'},
    "sb3_ppo_bridge_cnn": {"n_steps=64": "n_steps=8"},
    "sbx_ppo": {'"n_steps": 128': '"n_steps": 16', '"learning_starts": 1_000': '"learning_starts": 256'},
    "skrl_ppo": {"ROLLOUT, GAMMA = 16, 128": "ROLLOUT, GAMMA = 16, 16"},
    "torchrl_ppo": {"ROLLOUT, GAMMA = 16, 128": "ROLLOUT, GAMMA = 16, 16"},
    "ppo": {"n_steps: 128": "n_steps: 16"},
}
"""Numbers of the examples and of the zoo, so that a short training learns too."""
ZOO = {
    "ppo": "--set actions=normalized --set control=relative --set observation=features",
    "sac": "--set actions=normalized --set control=relative --set observation=features --set goal=True",
}
"""The options that the files of `rl/zoo/` give to the environment, as `armctl export` takes them."""


@pytest.fixture(scope="module")
def run():
    """Run examples, each in a fork of a process that has imported what most of them import."""
    quick_to_compile = "--xla_backend_optimization_level=0"  # what JAX runs a few times only
    imports = (*LEARNING, "armctl.integrations.sb3", "armctl.shaping")
    with page_runner(imports=imports, OMP_NUM_THREADS="1", XLA_FLAGS=quick_to_compile) as runner:
        yield runner


def with_fewer(name, file, folder):
    """Return the path of a copy with the numbers of `FEWER`."""
    text = file.read_text()
    for number, fewer in FEWER.get(name, {}).items():
        assert number in text, number
        text = text.replace(number, fewer)
    copy = folder / file.name
    copy.write_text(text)
    return copy


def printed_by(run, name, folder, *words):
    script = with_fewer(name, EXAMPLES / f"{name}.py", folder)
    shutil.copy(EXAMPLES / "held_out.py", folder)
    return run(folder / "work", [["script", str(script), *words]])


@pytest.mark.slow
@pytest.mark.parametrize("name", SCRIPTS)
def test_it_runs_and_says_its_success(run, name, tmp_path):
    printed = printed_by(run, name, tmp_path, "--steps", str(STEPS.get(name, 300)), "--episodes", "10")
    assert re.search(r"^success on 10 held-out episodes: [\d.]+% \[[\d.]+%, [\d.]+%\]$", printed, re.MULTILINE)


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", list(ZOO))
def test_the_zoo_trains_what_becomes_an_agent(run, algorithm, tmp_path):
    settings, env = with_fewer(algorithm, ROOT / "rl" / "zoo" / f"{algorithm}.yml", tmp_path), "armctl/ArmReach-v0"
    steps = {"ppo": 300, "sac": 2_100}[algorithm]
    train = f"--algo {algorithm} --env {env} --gym-packages armctl --n-timesteps {steps} --eval-freq -1 --seed {10**9}"
    run(tmp_path / "work", [["module", "rl_zoo3.train", *train.split(), "--conf-file", str(settings)]])
    [model] = tmp_path.glob(f"work/logs/{algorithm}/*/armctl-ArmReach-v0.zip")
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
