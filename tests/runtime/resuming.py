"""Comparisons of two short episodes, which tell whether they are another one."""

from armctl.study import compare

OPTIONS = {"max_episode_steps": 3}


def plays(out, policies="random", **options):
    return compare(policies, episodes=2, out=out, env_options=OPTIONS | options).resumed
