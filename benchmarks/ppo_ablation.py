"""Ablation of the PPO recipe for reaching: the recipe, and the same without each of its parts.

    python benchmarks/ppo_ablation.py [--steps 1000000] [--seed 0]

All learn in `armctl/ArmReach-v0` with position control, and are judged on 1,000 held-out episodes of its plain reward.
"""

import tempfile
from pathlib import Path

import typer
from rich.box import MARKDOWN
from rich.console import Console
from rich.table import Table

from armctl.training.learners import load_learner, load_recipe

VARIANTS = {
    "the recipe": {},
    "plain reward, without shaping": {"shaping": None},
    "bare observation, without features": {"features": False},
    "absolute joint positions as actions": {"relative": False},
    "plain in all three": {"shaping": None, "relative": False, "features": False},
}


def main(steps: int = 1_000_000, seed: int = 0) -> None:
    """Train each variant, and print a table."""
    table = Table("variant", "success", "95 % interval", "steps to goal", "minutes", box=MARKDOWN)
    table.title = f"PPO on armctl/ArmReach-v0, {steps:,} steps, training seed {seed}"
    recipe = load_recipe("reach_ppo")
    train = load_learner(recipe.learner)
    with tempfile.TemporaryDirectory() as folder:
        for name, changes in VARIANTS.items():
            options = {**recipe.options, "steps": steps, **changes}
            shaping = options.pop("shaping", recipe.shaping)
            variant = recipe.changed(shaping=shaping, options=options)
            card = train(variant, out=Path(folder) / name.replace(" ", "-"), seed=seed)
            result = card.evaluation
            assert result is not None
            low, high = result.success_interval
            to_goal = "-" if result.mean_steps_to_goal is None else f"{result.mean_steps_to_goal:.1f}"
            minutes = f"{card.training_minutes:.1f}"
            table.add_row(name, f"{result.success_rate:.1%}", f"{low:.1%} to {high:.1%}", to_goal, minutes)
    Console().print(table)


if __name__ == "__main__":
    typer.run(main)
