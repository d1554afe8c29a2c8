"""What a training costs: each learner's counts against counters of our own."""

import json
from importlib import resources
from pathlib import Path

import pytest
import torch

from armctl.agents import AgentCard
from armctl.agents.costs import TrainingCost
from armctl.core.errors import ConfigurationError
from armctl.core.files import sealed
from armctl.envs import TaskVectorEnv
from armctl.policies import make_policy
from armctl.rl.data import demonstrations
from armctl.rl.run.meter import COUNTS
from armctl.rl.run.training import Training
from armctl.study.curves import read_curve
from armctl.training.learners import load_learner, load_recipe

TINY = {
    "worlds": 4, "hidden_units": 8, "layers": 1, "features": "plain", "validation_episodes": 2,
    "evaluation_episodes": 2, "evaluation_every": 10**6,
}  # fmt: skip
PPO = {"steps": 128, "rollout_length": 8, "batch_size": 24, "epochs": 3}
SAC = {"steps": 200, "gradient_steps": 3, "batch_size": 16, "buffer_size": 500, "random_steps": 50}
CLONES = {"worlds": 1, "demonstrations": 6, "batch_size": 16, "steps": 12}
RECIPES = {
    "reach_ppo": PPO,
    "reach_sac": SAC,
    "reach_bc": CLONES,
    "reach_dagger": {**CLONES, "rounds": 3},
    "reach_cloned_ppo": {**PPO, "worlds": 1, "steps": 64, "critic_steps": 16, "demonstrations": 6, "cloning_steps": 5},
}
SHIPPED = Path(str(resources.files("armctl.rl.agents")))


def tiny(name, **options):
    changed = {**TINY, **RECIPES[name], **options}
    return load_recipe(name).changed(options=changed, env_options={"max_episode_steps": 10})


seen = dict.fromkeys(COUNTS, 0)


@pytest.fixture
def counted(monkeypatch, unexported):
    """Counts steps of all worlds but the held-out ones, a teacher's actions, and passes backwards through a network."""
    held_out = []
    step, make, backward = TaskVectorEnv.step, Training.__init__, torch.Tensor.backward

    def counted_step(worlds, actions):
        seen["decisions"] += worlds.num_envs * (worlds not in held_out)
        return step(worlds, actions)

    def counted_backward(loss, *args, **kwargs):
        seen["gradient_steps"] += 1
        return backward(loss, *args, **kwargs)

    def teacher(name, worlds, **arguments):
        policy = make_policy(name, worlds, **arguments)
        act = policy.act

        def counted_act(observations):
            seen["teacher_queries"] += len(observations)
            return act(observations)

        policy.act = counted_act
        return policy

    def made(training, *args):
        make(training, *args)
        held_out.append(training.held_out)

    monkeypatch.setattr(TaskVectorEnv, "step", counted_step)
    monkeypatch.setattr(torch.Tensor, "backward", counted_backward)
    monkeypatch.setattr(Training, "__init__", made)
    monkeypatch.setattr(demonstrations, "make_policy", teacher)
    seen.update(dict.fromkeys(COUNTS, 0))


def train(name, out, resume=False, **options):
    recipe = tiny(name, **options)
    return load_learner(recipe.learner)(recipe, out=out, seed=0, resume=resume, progress=False)


def counts(card):
    return {name: getattr(card, name) for name in COUNTS}


def expected(name):
    """What was counted. SAC goes backwards through actor, critic and temperature at each of its gradient steps."""
    networks = 3 if name == "reach_sac" else 1
    return {**seen, "gradient_steps": seen["gradient_steps"] / networks}


@pytest.mark.slow
@pytest.mark.parametrize("name", RECIPES)
def test_each_learner_counts_what_it_spends(name, counted, tmp_path):
    card = train(name, tmp_path / "run")
    assert counts(card) == expected(name)
    assert card.gradient_steps > 0 < card.decisions
    assert (card.teacher_queries > 0) == (card.teacher is not None)
    assert card.processor_seconds > 0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["reach_ppo", pytest.param("reach_sac", marks=pytest.mark.slow)])
def test_a_resumed_training_counts_on(name, counted, tmp_path):
    first = train(name, tmp_path / "run")
    more = train(name, tmp_path / "run", resume=True, steps=2 * RECIPES[name]["steps"])
    assert counts(more) == expected(name)
    assert more.processor_seconds > first.processor_seconds
    last = read_curve(tmp_path / "run" / "curve.csv").iloc[-1]
    assert last.decisions == more.decisions
    assert first.processor_seconds < last.processor_seconds <= more.processor_seconds


def test_a_resumed_clone_counts_its_demonstrations_once(counted, tmp_path):
    first = train("reach_bc", tmp_path / "run")
    more = train("reach_bc", tmp_path / "run", resume=True, steps=20)
    assert counts(more) == {**counts(first), "gradient_steps": 20}


@pytest.mark.slow
def test_counts_that_cannot_be_read_are_refused(tmp_path):
    """They would be wrong numbers on the card."""
    train("reach_ppo", tmp_path / "run")
    clock = tmp_path / "run" / "clock.json"
    written = clock.read_text()
    another = sealed({**json.loads(written), "format": 2})
    for text, says in (
        (written.replace(": 0,", ": 1,"), "was changed, or damaged"),
        (another, r"format 2; armctl .* format 1"),
        (None, "No such file"),
    ):
        clock.unlink() if text is None else clock.write_text(text)
        with pytest.raises(ConfigurationError, match=rf"clock\.json .*{says}"):
            train("reach_ppo", tmp_path / "run", resume=True, steps=256)


def test_a_card_without_costs_is_read():
    old = json.loads((SHIPPED / "reach_ppo.json").read_text())
    for name in (*COUNTS, "processor_seconds", "lineage", "tuning"):
        del old[name]
    assert AgentCard.model_validate(old).cost == TrainingCost(old["training_steps"], old["training_minutes"])


@pytest.mark.parametrize(
    ("cost", "says"),
    [
        (TrainingCost(20_000), "20,000 steps"),
        (TrainingCost(9, 13.59, 1_503_232, 0, 7_340), "1.5 million decisions and 7,340 gradient steps (13.6 minutes)"),
        (TrainingCost(9, 2, 499_499, 0, 9, 90), "499,000 decisions and 9 gradient steps (1.5 minutes of processor)"),
        (TrainingCost(12_000, None, None, None, 12_000), "12,000 gradient steps"),
        (TrainingCost(10, None, 999_500, 20, None), "1 million decisions and 20 teacher queries"),
    ],
)  # fmt: skip
def test_costs_are_readable(cost, says):
    assert str(cost) == says
