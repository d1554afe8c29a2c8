"""Turns a model of Stable-Baselines3 into an agent of armctl: an ONNX graph and a JSON card.

`armctl export model.zip --env ID --trust` runs this. The agent holds the observations' normalisation, is safe to load,
and needs neither torch nor Stable-Baselines3 to act.
"""

import os.path
import tempfile
from contextlib import closing
from importlib.metadata import version
from pathlib import Path

from armctl.agents import AgentCard, Conversion, OnnxPolicy, sha256, shapes
from armctl.core.errors import AgentFileError, ConfigurationError, os_errors_as
from armctl.core.files import write_atomically
from armctl.envs import full_id, make_worlds
from armctl.rl.export import sb3_file
from armctl.rl.export.sb3_actor import Sb3Actor
from armctl.rl.export.sb3_check import NUM_ENVS, OBSERVATIONS, largest_difference, raise_if_different
from armctl.rl.run.threads import bounded_threads
from armctl.runtime.provenance import versions
from armctl.training.learners import ModelExport

PACKAGES = ("stable-baselines3", "sb3-contrib", "torch", "onnx")


def export(request: ModelExport) -> AgentCard:
    """Write an agent and its card, and return the card.

    The statistics are a file of `VecNormalize`: by default, what `sb3_file.normalisation_beside` finds. The algorithm,
    of `sb3_file.ALGORITHMS`, need only be named if the file does not tell it.

    Before anything is written, agent and model act on `OBSERVATIONS` observations of the environment, and must agree.
    Without `trust` the model's file is not even opened. Raises `AgentFileError` or `ConfigurationError`.
    """
    _check_request(request)
    file = sb3_file.read(request.model)
    algorithm = request.algorithm or file.algorithm()
    statistics = request.normalisation or sb3_file.normalisation_beside(request.model)
    statistics = None if statistics == Path("none") else statistics
    with (
        closing(make_worlds(request.env, NUM_ENVS, request.env_options, threads=1)) as envs,
        bounded_threads(),
        tempfile.TemporaryDirectory() as folder,
    ):
        observation_space, action_space = envs.single_observation_space, envs.single_action_space
        loaded = sb3_file.load(file, algorithm, observation_space, action_space)
        normalised = None if statistics is None else sb3_file.load_normalisation(statistics)
        actor = Sb3Actor(loaded, observation_space, action_space, normalised)
        unchecked = Path(folder) / request.out.name
        actor.export(unchecked)
        card = AgentCard(
            name=request.out.stem,
            learner=f"sb3-{algorithm}",
            env=full_id(request.env),
            env_options=dict(request.env_options),
            interface=envs.task.interface,
            observation_shape=shapes(observation_space),
            action_shape=list(action_space.shape or ()),
            memory=actor.memory,
            training_steps=loaded.num_timesteps,
            training_minutes=None,
            training_seed=loaded.seed,
            learner_options=file.options(algorithm),
            versions=versions() | {package: version(package) for package in PACKAGES},
            sha256=sha256(unchecked),
        )
        difference = largest_difference(loaded, normalised, OnnxPolicy(unchecked, card), envs)
        raise_if_different(difference, action_space)
        content = unchecked.read_bytes()
    card.conversion = Conversion(
        saved_with=file.saved_with,
        source_sha256=sha256(request.model),
        normalisation=None if statistics is None else statistics.name,
        normalisation_sha256=None if statistics is None else sha256(statistics),
        observations=OBSERVATIONS,
        largest_difference=difference,
    )
    _write(request.out, content, card)
    return card


def _check_request(request: ModelExport) -> None:
    """Check what can be checked before the model's file is opened."""
    if request.out.suffix != ".onnx":
        raise ConfigurationError(f"an agent is a file .onnx, with its card beside it, not {request.out}")
    files = (request.out, request.out.with_suffix(".json"))
    if not request.overwrite and (existing := next(filter(os.path.exists, files), None)):
        raise ConfigurationError(f"{existing} exists already: choose another --out, or replace it with --overwrite")
    if not os.path.exists(request.model):  # also for a name that no file can have
        raise AgentFileError(f"there is no model {request.model}")
    if not request.trust:
        raise AgentFileError(
            f"{request.model} was not loaded: files of Stable-Baselines3 are pickles, which can run any code when they "
            "are loaded. If you trust where it comes from, say so: --trust"
        )


def _write(graph: Path, content: bytes, card: AgentCard) -> None:
    with os_errors_as(f"the agent cannot be written to {graph}", ConfigurationError):
        graph.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(graph, content)
        write_atomically(graph.with_suffix(".json"), card.model_dump_json(indent=2) + "\n")
