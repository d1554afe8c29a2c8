"""Reads results, agents, recipes and curves in a process of its own, with bounded memory: see `test_files.py`."""

import resource

from child import serve

from armctl.agents import load_agent
from armctl.envs import make_worlds
from armctl.report import write_report
from armctl.study import compare
from armctl.study.curves import read_curve
from armctl.study.reproduce import reproduce
from armctl.study.results import read_study
from armctl.training.learners import load_recipe

MEMORY = 8 * 2**30
"""Bytes of addresses."""
OPTIONS = {"max_episode_steps": 2}
WORLDS = make_worlds("armctl/ArmReach-v0", 1)


def check(path):
    """Do with a file or folder what its parent folder is named after."""
    match path.parent.name:
        case "read":
            study = read_study(path)
            for swept in study.tasks.values():
                swept.document()
            if study.kind == "suite":
                study.document()
        case "report":
            write_report(path, path / "report.html", video=False)
        case "resume":
            compare(["random", "reach_ppo"], episodes=3, out=path, env_options=OPTIONS)
        case "agent":
            load_agent(path / "agent.json", WORLDS)
        case "reproduce":
            reproduce(path / "agent.json")
        case "recipe":
            load_recipe(path / "recipe.toml")
        case "curve":
            read_curve(path / "curve.csv")
    return ""


if __name__ == "__main__":
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    serve(check)
