"""Digests of all that happens in every environment, bit for bit: they show whether a change changed an episode.

    python benchmarks/golden.py record before.json      # with the code as it was
    python benchmarks/golden.py record after.json       # with the code as it is
    python benchmarks/golden.py compare before.json after.json

Digests hold on one machine, with one set of packages. Through Gymnasium and `armctl.make_policy` alone, so that it runs
on any version of armctl.
"""

import hashlib
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from rich.progress import track

import armctl
from armctl.core.errors import ArmctlError

REACH, MOVING, OBSTACLES = "armctl/ArmReach-v0", "armctl/ArmReachMoving-v0", "armctl/ArmReachObstacles-v0"
POSE, PUSH, LIFT = "armctl/ArmPose-v0", "armctl/ArmPush-v0", "armctl/ArmLift-v0"
BARN, SCENES = "armctl/BarnCross-v0", "armctl/ArmScenes-v0"
BRIDGE, BRIDGE_MOVING = "armctl/BridgeCross-v0", "armctl/BridgeCrossMoving-v0"
EXPERTS = ("reach_ik", "reach_mpc", "reach_ompl", "bridge_ompl", "bridge_mpc")
AGENTS = ("reach_ppo", "reach_bc", "reach_dagger", "reach_sac", "moving_ppo")
DRIVERS = ("bridge_ppo", "bridge_distil")
LOOKAHEAD = ("obstacles_imagined", "bridge_moving_imagined")
POLICIES = (*EXPERTS, *AGENTS, *DRIVERS, *LOOKAHEAD, "random")
SEED = 7


def cases() -> Iterator[tuple[str, dict[str, Any], str, int, int]]:
    """Yield environment, options, policy, worlds and steps of each recorded run."""
    for env in (REACH, MOVING, OBSTACLES, BRIDGE, BRIDGE_MOVING):
        for policy in POLICIES:
            yield env, {}, policy, 3, 120
    for control in ("delta", "velocity", "torque"):
        for policy in ("reach_ik", "random"):
            yield REACH, {"control": control}, policy, 2, 40
    for robot in ("ur3", "ur10", "z1", "panda", "xarm7"):
        for env in (REACH, OBSTACLES):
            yield env, {"robot": robot, **({"solvable": False} if env == OBSTACLES else {})}, "reach_ik", 2, 40
        yield REACH, {"robot": robot}, "reach_mpc", 2, 40
    yield REACH, {"target": "box"}, "reach_ik", 4, 60
    for option in ({"observation": "state"}, {"camera": "classes"}, {"progress": 0.5, "blocks": 3, "walkers": 2}):
        for policy in ("random", "bridge_ompl"):
            yield BRIDGE, option, policy, 2, 60
    for name, arm, rover in (
        ("noise", 0.01, 0.1), ("delay", 2, 2), ("payload", 5, 10), ("friction", 0.2, 0.5), ("strength", 0.6, 0.6),
        ("pushes", 10, 10), ("mismatch", 0.05, 0.05),
    ):  # fmt: skip
        for policy in ("reach_ik", "reach_ppo"):
            yield REACH, {"disturbances": {name: arm}}, policy, 3, 50
        for policy in ("bridge_ompl", "bridge_ppo"):
            yield BRIDGE, {"disturbances": {name: rover}}, policy, 2, 60
    yield BRIDGE, {"disturbances": {"dropout": 0.25}}, "bridge_ppo", 2, 60
    for env, oracle in (
        (REACH, "distance"), (REACH, "ik"), (REACH, "mpc"), (MOVING, "ik"), (OBSTACLES, "ompl"),
        (BRIDGE, "distance"), (BRIDGE, "ompl"),
    ):  # fmt: skip
        yield env, {"shaping": oracle}, "random", 2, 40
    for policy in ("reach_ik", "reach_mpc", "reach_ruckig", "reach_rate", "random"):
        yield POSE, {}, policy, 3, 120
    for robot in ("panda", "z1"):
        yield POSE, {"robot": robot}, "reach_ik", 2, 60
    yield POSE, {"control": "velocity"}, "reach_ik", 2, 60
    yield POSE, {"shaping": "ik"}, "random", 2, 40
    for policy in ("reach_ompl", "reach_mpc", "reach_ik", "random"):
        yield SCENES, {}, policy, 3, 120
    for policy in ("push_line", "random"):
        yield PUSH, {}, policy, 3, 150
    for policy in ("bridge_ompl", "bridge_mpc", "random"):
        yield BARN, {"observation": "state"}, policy, 2, 60
    yield BARN, {}, "bridge_ompl", 2, 60
    yield PUSH, {"robot": "panda"}, "push_line", 2, 100
    yield PUSH, {"shaping": "push"}, "random", 2, 40
    for policy in ("lift_grasp", "random"):
        yield LIFT, {}, policy, 3, 120
    yield LIFT, {"shaping": "lift"}, "random", 2, 40


def name_of(env: str, options: dict[str, Any], policy: str, *_: int) -> str:
    """Return the name of a run."""
    return f"{env} {json.dumps(options, sort_keys=True)} {policy}"


def tried(*case: Any) -> dict[str, Any]:
    """Return what happens in one run, or the error of a policy that does not fit the environment."""
    try:
        return run(*case)
    except ArmctlError as error:
        return {"error": type(error).__name__}


def run(env: str, options: dict[str, Any], policy: str, num_envs: int, steps: int) -> dict[str, Any]:
    """Return what happens in one run: a digest of it all, and the outcomes, for people."""
    options = dict(options)
    oracle = options.pop("shaping", None)
    vec_env: Any = gymnasium.make_vec(env, num_envs=num_envs, autoreset_mode="disabled", threads=1, **options)
    actor = armctl.make_policy(policy, vec_env, policy_seed=SEED)
    playing: Any = vec_env
    if oracle:
        from armctl.shaping import Shaped

        playing = Shaped(vec_env, oracle, gamma=0.97)
    digest = hashlib.sha256()
    observations, infos = playing.reset(seed=[SEED] * num_envs, options={"episode": np.arange(num_envs)})
    actor.reset(np.arange(num_envs, dtype=np.int32))
    finished, returns, lengths = np.zeros(num_envs, bool), np.zeros(num_envs), np.zeros(num_envs, int)
    outcomes = [""] * num_envs
    _take_in(digest, observations, infos)
    for _ in range(steps):
        actions = actor.act(observations)
        observations, rewards, terminated, truncated, infos = playing.step(actions)
        _take_in(digest, observations, actions, rewards, terminated, truncated, infos)
        returns += rewards * ~finished
        lengths += ~finished
        for i in np.flatnonzero((terminated | truncated) & ~finished):
            outcomes[i] = vec_env.outcomes[infos["outcome_id"][i]]
        ends = terminated | truncated
        finished |= ends
        if finished.all():
            break
        if ends.any():
            observations, infos = playing.reset(options={"reset_mask": ends, "episode": np.arange(num_envs) + num_envs})
            actor.reset(np.flatnonzero(ends).astype(np.int32))
            _take_in(digest, observations, infos)
    vec_env.close()
    return {
        "digest": digest.hexdigest(),
        "outcomes": outcomes,
        "returns": returns.round(6).tolist(),
        "lengths": lengths.tolist(),
    }


def _take_in(digest: Any, *values: Any) -> None:
    for value in values:
        if isinstance(value, dict):
            for key in sorted(value):
                digest.update(key.encode())
                _take_in(digest, value[key])
        else:
            array = np.asarray(value)
            digest.update(str(array.tolist()).encode() if array.dtype.kind in "OUS" else array.tobytes())


def record(path: Path) -> None:
    """Play all cases, and write what happened."""
    runs: dict[str, Any] = {}
    for case in track(list(cases()), "golden run"):
        runs[name_of(*case)] = tried(*case)
    path.write_text(json.dumps(runs, indent=1) + "\n")


def compare(old: Path, new: Path) -> int:
    """Print what differs; the number of runs that do."""
    first, second = (json.loads(path.read_text()) for path in (old, new))
    differing = [name for name in first if first[name] != second.get(name)]
    for name in differing:
        print(f"{name}\n  before {first[name]}\n  after  {second.get(name)}")
    ran = sum("digest" in result for result in first.values())
    print(f"{len(first)} runs, {ran} of them with episodes: {len(differing)} differ")
    return len(differing)


if __name__ == "__main__":
    if sys.argv[1] == "record":
        record(Path(sys.argv[2]))
    else:
        sys.exit(compare(Path(sys.argv[2]), Path(sys.argv[3])) > 0)
