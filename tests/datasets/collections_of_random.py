"""Small collections of random actions, and whether two are the same."""

import json
import sys
import time
from pathlib import Path

from armctl.envs import make_worlds

from ..command_line import POLICY_SEED

ARMCTL = str(Path(sys.executable).parent / "armctl")
SHORT = {"max_episode_steps": 12}
EPISODES = 150
COMMAND = ["collect", "random", "--episodes", str(EPISODES), "--worlds", "7", "--set", "max_episode_steps=12"]
COMMAND += ["--policy-seed", str(POLICY_SEED)]


def worlds():
    return make_worlds("armctl/ArmReach-v0", 1)


def files(out):
    return {file.name: file.read_bytes() for file in (out / "data").iterdir()}


def same_dataset(out, other):
    """Whether two datasets hold the same; their names may differ."""
    ours, theirs = files(out), files(other)
    about, about_other = json.loads(ours.pop("metadata.json")), json.loads(theirs.pop("metadata.json"))
    for one in (about, about_other):
        del one["dataset_id"], one["checksum"]
    return ours == theirs and about == about_other and not (out / "unfinished").exists()


def wait_for_episodes(process, out, count):
    """Wait until so many episodes are finished: the result of the last one is written after its observations."""
    while process.poll() is None and len(list((out / "unfinished").glob("episode_*.npz"))) <= count:
        time.sleep(0.005)
