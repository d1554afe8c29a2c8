"""Search for policies by name, file or as Python objects.

A package offers a policy under the entry-point group `armctl.policies`: a function from an environment to a `Policy`.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium

from armctl.agents import FILES, OnnxPolicy, load_agent
from armctl.agents.costs import UNTRAINED
from armctl.core.errors import FAILURES, ArmctlError, ConfigurationError, described
from armctl.core.registration import import_attribute, load_installed
from armctl.envs import EpisodeVectorEnv, Interface, PolicyStreams, TaskEnv, chosen_policy_seed
from armctl.policies.configuration import configured, options_in, tuning_of
from armctl.policies.names import (
    FILTERED,
    GROUP,
    agent_cards,
    check_policy_name,
    declared_sees,
    policy_names,
    with_agent,
    without_filter,
)
from armctl.policies.plain import adapted
from armctl.policies.policy import Policy
from armctl.policies.trainings import training_card
from armctl.remote.names import is_remote


def is_expert(policy: Any) -> bool:
    """Return True if this names an installed policy that works with a model of the robot, a map or the state."""
    name = str(without_filter(policy)) if isinstance(policy, (str, Path)) else ""
    if (configuration := configured(name)) is not None:
        name = configuration.policy
    return name in policy_names() and name not in agent_cards() and declared_sees(name) != "observation"


def policy_name(policy: Any) -> str:
    """Return a policy's name in results."""
    return str(policy) if isinstance(policy, (str, Path)) else getattr(policy, "__name__", type(policy).__name__)


def named_policies(policies: Any) -> dict[str, Any]:
    """Return policies by the names that they have in results, from one policy, several, or a mapping from names.

    Raises `ConfigurationError` if there is none, or one twice.
    """
    if isinstance(policies, Mapping):
        by_name = dict(policies)
    else:
        named = [policies] if isinstance(policies, (str, Path)) or callable(policies) else list(policies)
        named = [with_agent(policy) if isinstance(policy, str) else policy for policy in named]
        by_name = {policy_name(policy): policy for policy in named}
        if len(by_name) != len(named):
            raise ConfigurationError(
                f"each policy can be compared only once, not {', '.join(map(policy_name, named))}: two of one name "
                "need others, {'first': policy, 'second': policy}"
            )
    if not by_name:
        raise ConfigurationError("a comparison needs at least one policy")
    return by_name


def make_policy(
    policy: Any,
    env: gymnasium.Env[Any, Any] | EpisodeVectorEnv | Interface,
    *,
    name: str | None = None,
    policy_seed: int | None = None,
) -> Policy:
    """Make a policy for the worlds of `env`: an environment, or the interface of a policy that is made of another.

    `policy` is one of these:

    - the name of an installed policy;
    - the path of a learned agent's `.json` card or `.onnx` graph, or of a folder with `agent.json`; one that was
      trained behind the safety filter also acts behind it;
    - the path of a `.toml` file with an installed policy's options (see `armctl.policies.configuration`), or these
      after its name, `reach_mpc:problem.horizon=12`;
    - `NAME[SEED]`, one training of a recipe (see `armctl.policies.trainings`);
    - `filtered(POLICY)`, any named policy behind the safety filter, whose options may follow,
      `filtered(reach_ppo):margin=0.02` (see `armctl.policies.filtered`);
    - a function of one world's observation that returns an action;
    - a class with `act(observation)`, and `reset()` if it has memory. Each world gets an instance, made without
      arguments, or with `env` if the constructor has a parameter of that name;
    - a function with a parameter `env` that makes a policy for the worlds of a vector environment;
    - a model with the `predict` of Stable-Baselines3's, or an object with `act`;
    - `module:name` or `path/to/file.py:name` of any of these functions, classes and objects;
    - `ws://HOST:PORT`, a policy server, or `python=INTERPRETER:MODULE:NAME`, code for another Python, which runs it in
      a process of its own (see `armctl.policies.remote`);
    - a `Policy`, which acts in all worlds at once.

    Where it says `env`, a policy gets an `Interface` of copies, with as much as it declares to see (`armctl.sees`);
    only one that sees the state gets the environment itself. The random numbers of `env.rng` are determined by
    `policy_seed`, a whole number of up to 128 bits, together with the policy's `name` in results (by default its own)
    and the episode. Without a `policy_seed` one is drawn, so that another call gives other numbers.

    Raises `ConfigurationError` for an unknown name, or for a policy that sees more than was declared, and
    `AgentFileError` for a file that cannot be run here.
    """
    worlds: Any = env if isinstance(env, Interface) else env.unwrapped
    if isinstance(worlds, TaskEnv):
        worlds = worlds.worlds
    if not isinstance(worlds, (EpisodeVectorEnv, Interface)):
        raise ConfigurationError(
            f"policies act in worlds that armctl has made (armctl.envs.make_worlds), and {env} is not among them"
        )
    try:
        label = policy_name(policy) if name is None else name
        streams = PolicyStreams(label, chosen_policy_seed(policy_seed))
        result = _make(policy, worlds, streams)
    except ArmctlError:
        raise
    except FAILURES as error:
        raise ConfigurationError(f"{policy_name(policy)} could not be made: {described(error)}") from error
    if isinstance(policy, (str, Path)) and (tuned := tuning_of(str(policy))) and not hasattr(result, "training_cost"):
        result.training_cost = replace(UNTRAINED, tuning=tuned)  # type: ignore[attr-defined]
    return result


def loaded(policy: Any) -> Any:
    """Return a function, class or object that makes a policy, or is one, of any form that `make_policy` takes.

    Of a policy behind the safety filter, return that of the policy. Of a learned agent's file or training, return its
    path. Raises `ConfigurationError` and `AgentFileError`.
    """
    if not isinstance(policy, (str, Path)):
        return policy
    name = with_agent(str(without_filter(policy)))
    if is_remote(name):
        from armctl.policies.remote import remote_policy  # it needs the extra `remote`

        return remote_policy(name)
    if Path(name).suffix in FILES:
        return Path(name)
    if (card := training_card(name)) is not None:
        return card
    if Path(name).suffix == ".zip":
        raise ConfigurationError(
            f"{name} may be a model of Stable-Baselines3's, which holds pickles: "
            f"`armctl export {name} --env ID --out agent.onnx --trust` makes an agent of it"
        )
    if (configuration := configured(name)) is not None:
        return configuration.make()
    if name in policy_names():
        return load_installed(GROUP, name, "policy")
    check_policy_name(name)
    return import_attribute(name, "policy")


def _make(policy: Any, worlds: EpisodeVectorEnv | Interface, streams: PolicyStreams) -> Policy:
    if isinstance(policy, str) and (match := FILTERED.fullmatch(policy)) is not None:
        check_policy_name(policy)
        options = {} if match["options"] is None else options_in(policy, match["options"])
        return _filtered(_make_unfiltered(match["policy"], worlds, streams), worlds, policy, options)
    result = _make_unfiltered(policy, worlds, streams)
    if isinstance(policy, (str, Path)) and isinstance(result, OnnxPolicy) and result.card.filter is not None:
        return _filtered(result, worlds, str(policy), result.card.filter)
    return result


def _filtered(policy: Policy, worlds: EpisodeVectorEnv | Interface, name: str, options: Mapping[str, Any]) -> Policy:
    from armctl.policies.filtered import Filtered, SafetyFilter  # compiled arithmetic takes long to import

    return Filtered(policy, SafetyFilter(worlds, name, options))


def _make_unfiltered(policy: Any, worlds: EpisodeVectorEnv | Interface, streams: PolicyStreams) -> Policy:
    name = with_agent(str(policy)) if isinstance(policy, (str, Path)) else policy_name(policy)
    source = loaded(policy)
    if isinstance(source, Path):
        return load_agent(source, worlds)
    if isinstance(policy, (str, Path)) and worlds.normalized and is_expert(name):
        raise ConfigurationError(f"{name} acts in physical units, not in worlds with actions='normalized'")
    return adapted(source, worlds, name, streams)
