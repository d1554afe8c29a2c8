"""How an agent got better: each checkpoint of a training on the same held-out episodes.

    python benchmarks/learning_curve.py runs/ppo-0 [--episodes 200]

Checkpoints are pickles: give it a training of your own making only.
"""

import json
import tempfile
from pathlib import Path

import gymnasium
import typer
from armctl.rl.ppo import RECIPES, PpoOptions, export
from rich.box import SIMPLE
from rich.console import Console
from rich.progress import track
from rich.table import Table
from stable_baselines3 import PPO

from armctl.agents import read_card, sha256
from armctl.evaluation import evaluate
from armctl.evaluation.statistics import success_rate


def main(run: Path, episodes: int = 200, seed: int = 0) -> None:
    """Evaluate the checkpoints of the folder `run`, and print a table."""
    card = read_card(run / "agent.json")
    settings = json.loads((run / "settings.json").read_text())
    worlds = gymnasium.make_vec(card.env, num_envs=1)
    scale = RECIPES[card.env].action_scale(worlds.unwrapped, PpoOptions(**settings["options"]))
    found = sorted((run / "checkpoints").glob("ppo_*_steps.zip"), key=lambda path: int(path.stem.split("_")[1]))
    title = f"{card.env}, training seed {card.training_seed}: {episodes} held-out episodes"
    table = Table("steps", "success", "95 % interval", "mean return", title=title, title_justify="left", box=SIMPLE)
    with tempfile.TemporaryDirectory() as folder:
        for checkpoint in track(found, console=Console(stderr=True), transient=True):
            agent = Path(folder) / f"{checkpoint.stem}.json"
            model = PPO.load(checkpoint, device="cpu")
            export(model, scale, agent.with_suffix(".onnx"))
            known = card.model_copy(update={"sha256": sha256(agent.with_suffix(".onnx"))})
            agent.write_text(known.model_dump_json())
            results = evaluate(str(agent), card.env, episodes=episodes, seed=seed, worlds=50)
            rate = success_rate(results.success.to_numpy(bool))
            assert rate is not None
            interval = f"{rate.low:.1%} to {rate.high:.1%}"
            table.add_row(f"{model.num_timesteps:,}", f"{rate.value:.1%}", interval, f"{results['return'].mean():.1f}")
    Console().print(table)


if __name__ == "__main__":
    typer.run(main)
