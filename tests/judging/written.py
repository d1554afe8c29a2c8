"""Result files as others write them."""

import json

import numpy as np

from armctl.judging import judge


def rows_of(wins, policies=("new", "old"), columns="policy,episode,success"):
    """Rows of a CSV file: episode k of each policy is a success if k is in its `wins`."""
    lines = [columns]
    for policy, won in zip(policies, wins, strict=True):
        lines += [f"{policy},{k},{'yes' if k in won else 'no'}" for k in range(40)]
    return lines


WINS = set(range(36)), set(range(8, 30))
"""Episodes that the better policy wins, and those that the other one does."""


def table(folder, lines, name="trials.csv", **encoding):
    (folder / name).write_text("\n".join(lines) + "\n", **{"encoding": "utf-8"} | encoding)
    return folder / name


def judged(folder, lines, name="trials.csv", columns=None, **terms):
    return judge(table(folder, lines, name), columns, **terms)


def lerobot(folder, wins, tasks=2):
    """LeRobot's file of today, and that of 2024, of the same episodes of one task."""
    metrics = {"sum_rewards": [2.0 * (k in wins) for k in range(40)], "max_rewards": [1.0] * 40,
               "successes": [k in wins for k in range(40)], "video_paths": []}  # fmt: skip
    today = {
        "per_task": [{"task_group": "libero_10", "task_id": i, "metrics": metrics} for i in range(tasks)],
        "per_group": {}, "overall": {"pc_success": 50.0},
    }  # fmt: skip
    before = {
        "per_episode": [
            {
                "episode_ix": k,
                "sum_reward": 2.0 * (k in wins),
                "max_reward": 1.0,
                "success": k in wins,
                "seed": 1000 + k,
            }
            for k in range(40)
        ],
        "aggregated": {"pc_success": 50.0},
    }
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "eval_info.json").write_text(json.dumps(today))
    (folder / "before.json").write_text(json.dumps(before))
    return folder


def vla_eval(path, wins, lost=()):
    episodes = [
        {"episode_id": k, "metrics": {"success": k in wins}, "steps": 100 + k, "elapsed_sec": 3.5}
        | ({"failure_reason": "timeout"} if k in lost else {})
        for k in range(40)
    ]
    task = {"task": "pick", "episodes": episodes, "num_episodes": 40, "avg_steps": 1.0, "mean_success": 0.5}
    document = {"benchmark": "b", "mode": "sync", "harness_version": "0.8.0", "created_at": "", "tasks": [task],
                "config": {}, "seed": 7, "metric_keys": {"success": "mean"}}  # fmt: skip
    path.write_text(json.dumps(document))
    return path


def robo_evals(path, policy, wins):
    episodes = [
        {"task": "reach", "episode": k, "seed": 10**9 + k, "success": k in wins, "steps": 50 + k, "video": None,
         "steps_to_success": 50 + k if k in wins else None}
        for k in range(40)
    ]  # fmt: skip
    document = {"schema": "robo-evals/report/1", "policy": policy, "config": {"max_steps": 300, "seed": 0},
                "environment": {}, "video_available": None, "wall_time_s": 1.0, "overall": {},
                "tasks": [{"task": "reach", "episodes": 40, "episode_results": episodes}]}  # fmt: skip
    path.write_text(json.dumps(document))
    return path


def evaluations(path, mean, seed=0, successes=False):
    """What `EvalCallback` keeps: two evaluations of 20 episodes each."""
    rng = np.random.default_rng(seed)
    path.parent.mkdir(parents=True, exist_ok=True)
    more = {"successes": rng.random((2, 20)) < mean} if successes else {}
    np.savez(
        path, timesteps=[1000, 2000], results=rng.normal(mean, 1.0, (2, 20)), ep_lengths=np.full((2, 20), 200), **more
    )
    return path
