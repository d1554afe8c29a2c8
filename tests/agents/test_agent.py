import json
import os
import re
import shutil
import subprocess
import sys
from importlib import resources
from pathlib import Path

import numpy as np
import onnx
import pytest

from armctl.agents import load_agent, read_card, sha256
from armctl.core.errors import AgentFileError
from armctl.envs import TaskVectorEnv, make_worlds
from armctl.rollout import evaluate
from armctl.tasks import ReachTask
from armctl.training.learners import load_recipe

SHIPPED = Path(str(resources.files("armctl.rl.agents")))
ENV = "armctl/ArmReach-v0"


@pytest.fixture
def agent(tmp_path):
    """A copy of the shipped agent, to be spoilt."""
    for suffix in (".json", ".onnx"):
        shutil.copy(SHIPPED / f"reach_ppo{suffix}", tmp_path / f"agent{suffix}")
    return tmp_path / "agent.json"


def edit(card, **changes):
    card.write_text(json.dumps(json.loads(card.read_text()) | changes))


def load(card, **options):
    return load_agent(card, make_worlds(ENV, 1, options))


def test_card_or_graph_may_be_named(agent):
    worlds = TaskVectorEnv(3, task=ReachTask)
    observations, _ = worlds.reset(seed=0)
    first = load_agent(agent, worlds).act(observations)
    np.testing.assert_array_equal(load_agent(agent.with_suffix(".onnx"), worlds).act(observations), first)


@pytest.mark.parametrize("junk", [b"", b"\x00\xff junk", b"not an onnx file" * 100])
def test_corrupt_graph(agent, junk):
    graph = agent.with_suffix(".onnx")
    graph.write_bytes(junk)
    with pytest.raises(AgentFileError, match="changed, or damaged"):
        load(agent)
    edit(agent, sha256=sha256(graph))
    with pytest.raises(AgentFileError, match="not an ONNX graph"):
        load(agent)


def test_truncated_graph(agent):
    graph = agent.with_suffix(".onnx")
    graph.write_bytes(graph.read_bytes()[:5000])
    edit(agent, sha256=sha256(graph))
    with pytest.raises(AgentFileError):
        load(agent)


def test_a_graph_of_terabytes_that_holds_nothing_is_not_read(agent):
    os.truncate(agent.with_suffix(".onnx"), 10**13)
    with pytest.raises(AgentFileError, match="10,000,000,000,000 bytes, more than the 268,435,456"):
        load(agent)


def test_foreign_graph(agent):
    value = onnx.helper.make_tensor_value_info("x", onnx.TensorProto.FLOAT, [None, 12])
    other = onnx.helper.make_tensor_value_info("y", onnx.TensorProto.FLOAT, [None, 12])
    graph = onnx.helper.make_graph([onnx.helper.make_node("Identity", ["x"], ["y"])], "foreign", [value], [other])
    model = onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 18)], ir_version=8)
    onnx.save(model, agent.with_suffix(".onnx"))
    edit(agent, sha256=sha256(agent.with_suffix(".onnx")))
    with pytest.raises(AgentFileError, match=r"\{'x': \[12\]\}"):
        load(agent)


@pytest.mark.parametrize("text", ["", "{", "[]", "{}", '{"format": "pickle"}', "\x80\x04cos\nsystem"])
def test_corrupt_card(agent, text):
    agent.write_text(text)
    with pytest.raises(AgentFileError, match="not an agent's card"):
        load(agent)


def test_a_card_of_another_format_names_the_version_that_reads_this_one(agent):
    edit(agent, format="armctl-agent-2")
    with pytest.raises(AgentFileError, match=r"it has format armctl-agent-2; armctl \d.* reads format armctl-agent-1"):
        load(agent)
    edit(agent, format=None)
    with pytest.raises(AgentFileError, match="it has no format number"):
        load(agent)


def test_a_card_without_a_format_is_of_the_first_one(agent):
    card = json.loads(agent.read_text())
    del card["format"]
    agent.write_text(json.dumps(card))
    assert load(agent).card.format == "armctl-agent-1"


def test_missing_files(agent, tmp_path):
    with pytest.raises(AgentFileError, match="there is no agent"):
        load(tmp_path / "none.json")
    agent.with_suffix(".onnx").unlink()
    with pytest.raises(AgentFileError, match="missing"):
        load(agent)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"robot": "ur10"}, "ur10"),
        ({"control": "delta"}, "delta"),
        ({"observation": {"q": lambda s: s.joint_positions}}, "6"),
    ],
)
def test_agent_of_another_robot_control_or_observation(agent, options, says):
    with pytest.raises(AgentFileError, match=says):
        load(agent, **options)


@pytest.mark.parametrize("env", ["armctl/BridgeCross-v0", "armctl/ArmReachMoving-v0"])
def test_agent_of_another_environment(agent, env):
    with pytest.raises(AgentFileError, match="agent reach_ppo"):
        load_agent(agent, make_worlds(env, 1))


def test_no_file_is_ever_unpickled():
    import armctl

    for file in Path(armctl.__file__).parent.rglob("*.py"):
        text = file.read_text()
        if file.name not in ("isolation.py", "isolated.py"):  # what armctl sends to a policy's own process is no file
            assert "import pickle" not in text, file
        assert "torch.load" not in text, file
        assert file.name in ("sb3.py", "tensorboard.py") or not re.search(r"^\s*(import|from) torch\b", text, re.M), (
            file
        )


@pytest.mark.parametrize("path", sorted(SHIPPED.glob("*.json")), ids=lambda path: path.stem)
def test_a_shipped_card_is_of_the_present_recipe(path):
    from armctl.rl.algorithms.act import ActOptions
    from armctl.rl.algorithms.bc import BcOptions
    from armctl.rl.algorithms.cloned_ppo import ClonedPpoOptions
    from armctl.rl.algorithms.dagger import DaggerOptions
    from armctl.rl.algorithms.distil import DistilOptions
    from armctl.rl.algorithms.distilled_ppo import DistilledPpoOptions
    from armctl.rl.algorithms.finetuned_ppo import FinetunedPpoOptions
    from armctl.rl.algorithms.flow_matching import FlowOptions
    from armctl.rl.algorithms.imagined_dagger import ImaginedDaggerOptions
    from armctl.rl.algorithms.plan_bc import PlanBcOptions
    from armctl.rl.algorithms.ppo import PpoOptions
    from armctl.rl.algorithms.sac import SacOptions
    from armctl.rl.algorithms.td_mpc2 import TdMpcOptions

    card = read_card(path)
    assert card.recipe is not None
    recipe = load_recipe(card.recipe)
    for name in ("learner", "env", "env_options", "training_options", "shaping", "reward_weights", "teacher"):
        assert getattr(card, name) == getattr(recipe, name), name
    assert card.curriculum == [stage.model_dump() for stage in recipe.curriculum]
    assert card.training_seed in recipe.seeds
    kinds = {
        "bc": BcOptions, "cloned_ppo": ClonedPpoOptions, "dagger": DaggerOptions, "distil": DistilOptions,
        "distilled_ppo": DistilledPpoOptions, "finetuned_ppo": FinetunedPpoOptions, "flow_matching": FlowOptions,
        "imagined_dagger": ImaginedDaggerOptions, "plan_bc": PlanBcOptions, "ppo": PpoOptions, "sac": SacOptions,
        "act": ActOptions, "td_mpc2": TdMpcOptions,
    }  # fmt: skip
    kind = kinds[card.learner]
    assert kind(**card.learner_options) == recipe.read_options(kind)  # later options have their defaults


def test_an_agent_whose_graph_lacks_the_memory_of_its_card(agent):
    edit(agent, memory={"lstm_hidden": [1, 8]})
    with pytest.raises(
        AgentFileError, match=r"it maps \{'observation': \[12\], 'lstm_hidden': \[1, 8\]\} to \{'action': \[6\], 'next_"
    ):
        load(agent)


def test_observations_of_another_precision(agent):
    policy, worlds = load(agent), TaskVectorEnv(2, task=ReachTask)
    observations, _ = worlds.reset(seed=0)
    np.testing.assert_array_equal(policy.act(observations.astype(np.float64)), policy.act(observations))


def test_a_card_of_before_there_were_recipes_is_read(agent):
    old = json.loads(agent.read_text())
    for name in ("recipe", "shaping", "shaping_scale", "reward_weights", "teacher", "best_after"):
        old.pop(name, None)
    agent.write_text(json.dumps(old))
    card = read_card(agent)
    assert (card.recipe, card.shaping, card.reward_weights, card.teacher) == (None, None, {}, None)
    assert load(agent).training_steps == card.training_steps


@pytest.mark.slow
def test_shipped_agent_does_what_its_card_says():
    card = read_card(SHIPPED / "reach_ppo.json")
    assert card.training_minutes <= 20
    results = evaluate("reach_ppo", episodes=200, seed=card.evaluation.seed, worlds=64, lower_bound_steps=False)
    assert results.success.mean() == pytest.approx(card.evaluation.success_rate, abs=0.01)
    assert results.success.mean() >= 0.95
    elsewhere = evaluate("reach_ppo", episodes=100, seed=77, worlds=64, lower_bound_steps=False)
    assert elsewhere.success.mean() >= 0.95


@pytest.mark.slow
def test_agents_need_no_torch():
    """It belongs to an extra."""
    code = "import sys, armctl.rl.agents; assert not {'torch', 'stable_baselines3'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)
