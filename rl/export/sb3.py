"""Turns a model of Stable-Baselines3 into an agent of armctl: an ONNX graph and a JSON card.

`armctl export model.zip --env ID --trust` runs this. The agent holds the observations' normalisation, is safe to load,
and needs neither torch nor Stable-Baselines3 to act.
"""

import os.path
import tempfile
from collections.abc import Mapping
from contextlib import closing
from importlib.metadata import version
from pathlib import Path
from typing import Any

from armctl.agents import AgentCard, Conversion, OnnxPolicy, sha256, shapes
from armctl.core.errors import AgentFileError, ConfigurationError
from armctl.core.files import write_atomically
from armctl.envs import full_id, make_worlds
from armctl.rl.export import sb3_file
from armctl.rl.export.sb3_actor import Sb3Actor
from armctl.rl.export.sb3_check import NUM_ENVS, OBSERVATIONS, largest_difference, raise_if_different
from armctl.rl.run.threads import bounded_threads
from armctl.runtime.provenance import versions

PACKAGES = ("stable-baselines3", "sb3-contrib", "torch", "onnx")


def export(
    model: Path,
    *,
    env: str,
    out: Path,
    env_options: Mapping[str, Any] | None = None,
    normalisation: Path | None = None,
    algorithm: str | None = None,
    trust: bool = False,
    overwrite: bool = False,
) -> AgentCard:
    """Write the agent `out` (`.onnx`), and its card beside it, and return the card.

    `normalisation` is a file of `VecNormalize`. By default it is what `sb3_file.normalisation_beside` finds; a path
    named `none` is none. `algorithm`, of `sb3_file.ALGORITHMS`, need only be named if the file does not tell it.

    Before anything is written, agent and model act on `OBSERVATIONS` observations of the environment, and must agree.
    Without `trust` the model's file is not even opened. Raises `AgentFileError` or `ConfigurationError`.
    """
    if out.suffix != ".onnx":
        raise ConfigurationError(f"an agent is a file .onnx, with its card beside it, not {out}")
    graph, card_file = out.with_suffix(".onnx"), out.with_suffix(".json")
    if not overwrite and (existing := next(filter(os.path.exists, (graph, card_file)), None)):
        raise ConfigurationError(f"{existing} exists already: choose another --out, or replace it with --overwrite")
    if not trust:
        raise AgentFileError(
            f"{model} was not loaded: files of Stable-Baselines3 are pickles, which can run any code when they are "
            "loaded. If you trust where it comes from, say so: --trust"
        )
    file = sb3_file.read(model)
    name = algorithm or file.algorithm()
    statistics = sb3_file.normalisation_beside(model) if normalisation is None else normalisation
    statistics = None if statistics == Path("none") else statistics
    with closing(make_worlds(env, NUM_ENVS, env_options, threads=1)) as envs, bounded_threads():
        loaded = sb3_file.load(file, name)
        normalised = None if statistics is None else sb3_file.load_normalisation(statistics)
        observation_space, action_space = envs.single_observation_space, envs.single_action_space
        actor = Sb3Actor(loaded, observation_space, action_space, normalised)
        with tempfile.TemporaryDirectory() as folder:
            unchecked = Path(folder) / graph.name
            actor.export(unchecked)
            card = AgentCard(
                name=graph.stem,
                learner=f"sb3-{name}",
                env=full_id(env),
                env_options=dict(env_options or {}),
                interface=envs.task.interface,
                observation_shape=shapes(observation_space),
                action_shape=list(action_space.shape or ()),
                memory=actor.memory,
                training_steps=loaded.num_timesteps,
                training_minutes=None,
                training_seed=loaded.seed,
                learner_options=file.options(name),
                versions=versions() | {package: version(package) for package in PACKAGES},
                sha256=sha256(unchecked),
            )
            difference = largest_difference(loaded, normalised, OnnxPolicy(unchecked, card), envs)
            raise_if_different(difference, action_space)
            content = unchecked.read_bytes()
    card.conversion = Conversion(
        saved_with=file.saved_with,
        source_sha256=sha256(model),
        normalisation=None if statistics is None else statistics.name,
        normalisation_sha256=None if statistics is None else sha256(statistics),
        observations=OBSERVATIONS,
        largest_difference=difference,
    )
    try:
        graph.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(graph, lambda path: path.write_bytes(content))
        write_atomically(card_file, card.model_dump_json(indent=2) + "\n")
    except OSError as error:
        raise ConfigurationError(f"the agent cannot be written to {graph}: {error.strerror}") from error
    return card
