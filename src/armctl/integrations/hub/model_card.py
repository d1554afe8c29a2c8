"""The model card of an agent: a page for readers, and metadata by which a hub finds and lists it.

All its numbers are those of the agent's own card.
"""

import shlex
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from armctl import DISTRIBUTION
from armctl.agents import CARD, GRAPH, AgentCard
from armctl.core.console import printable
from armctl.core.errors import ConfigurationError
from armctl.core.options import option_arguments
from armctl.core.registration import bare_id
from armctl.envs import check_from_file, task_of

TAGS = ("reinforcement-learning", "robotics", "onnx", "armctl")
PAGE = """---
{metadata}
---

# {name}

An agent for {env}, made with [armctl](https://github.com/armctl/armctl), which compares planners and controllers with
learned agents on the same robot episodes.

## Use

```sh
pip install '{distribution}[hub]'
armctl pull {repository}
{command}
```

## Task

{task}

## Evaluation

{evaluation}

## Training

{training}

`{card}` has all the options.

## Safety

`{graph}` is data: numbers, and standard operators without loops, functions or code. Nothing is unpickled. `armctl pull`
downloads the graph, its card and its learning curve, never another file, and refuses a graph with other operators or
with another checksum than its card's. A checksum shows damage, but not who made a file.

SHA-256 of the graph: `{sha256}`

## Licence

{licence}
"""


def model_card(card: AgentCard, repository: str, licence: str | None = None) -> str:
    """Return the text of a repository's `README.md`: Markdown with metadata in YAML. No licence is None."""
    local = folder_of(repository) / CARD
    try:
        command = comparison_command(card, local)
    except ConfigurationError:
        command = shlex.join(("armctl", "compare", str(local)))
    return PAGE.format(
        metadata=_metadata(card, licence),
        name=_plain(card.name),
        env=_code(card.env),
        distribution=DISTRIBUTION,
        repository=repository,
        command=_plain(command),
        task=_list(_task(card)),
        evaluation=_evaluation(card),
        training=_list(_training(card)),
        card=CARD,
        graph=GRAPH,
        sha256=card.sha256,
        licence=_code(licence) if licence else "None is stated: ask whoever published it.",
    )


def comparison_command(card: AgentCard, path: Path) -> str:
    """Return the command that compares the agent at `path` with its task's first expert.

    Raises `ConfigurationError` if the environment on its card is unknown here, or is code that the user has not named.
    """
    check_from_file(card.env, card.env_options, str(path))
    rival = task_of(card.env).default_policies[0]
    return shlex.join(("armctl", "compare", rival, str(path), "--env", card.env, *option_arguments(card.env_options)))


def folder_of(repository: str) -> Path:
    """Return the folder into which `armctl pull` puts an agent by default."""
    return Path("agents", repository)


def _metadata(card: AgentCard, licence: str | None) -> str:
    from huggingface_hub import EvalResult, ModelCardData

    results = None
    if card.evaluation is not None:
        measured = {"success_rate": card.evaluation.success_rate, "mean_reward": card.evaluation.mean_return}
        results = [
            EvalResult(
                task_type="reinforcement-learning",
                task_name="reinforcement-learning",
                dataset_type=card.env,
                dataset_name=card.env,
                dataset_args={"episodes": card.evaluation.episodes, "seed": card.evaluation.seed, **card.env_options},
                metric_type=metric,
                metric_name=metric.replace("_", " "),
                metric_value=value,
            )
            for metric, value in measured.items()
        ]
    return ModelCardData(
        model_name=card.name,
        library_name="armctl",
        license=licence,
        pipeline_tag="reinforcement-learning",
        tags=[*TAGS, bare_id(card.env)],
        eval_results=results,
    ).to_yaml()


def _task(card: AgentCard) -> Iterable[tuple[str, str]]:
    yield "Environment", _code(card.env)
    if card.env_options:
        yield "Options other than the defaults", _values(card.env_options)
    yield "It sees", f"{card.sees}: {_sizes(card.observation_shape)}"
    yield "It returns", f"actions: {_sizes(card.action_shape)}"
    if card.memory:
        yield "It remembers", _sizes(card.memory)
    if card.interface:
        yield "The task must share with the training", _values(card.interface)


def _evaluation(card: AgentCard) -> str:
    evaluation = card.evaluation
    if evaluation is None:
        return "It has not been evaluated."
    low, high = (f"{100 * bound:.1f}" for bound in evaluation.success_interval)
    steps = "" if evaluation.mean_steps_to_goal is None else f", steps to the goal {evaluation.mean_steps_to_goal:g}"
    return (
        f"Success: **{100 * evaluation.success_rate:.1f} % [{low}, {high}]** of {evaluation.episodes:,} held-out "
        f"episodes, seed {evaluation.seed} (exact 95 % interval of Clopper and Pearson). "
        f"Means: return {evaluation.mean_return:g}{steps}.\n\n"
        "`armctl reproduce` plays these episodes again, and says whether the agent does what is claimed here."
    )


def _training(card: AgentCard) -> Iterable[tuple[str, str]]:
    scale = "" if card.shaping_scale is None else f", scale {card.shaping_scale:g}"
    facts = {
        "Learner": _code(card.learner),
        "Recipe": card.recipe is not None and _code(card.recipe),
        "Seed": card.training_seed is not None and str(card.training_seed),
        "Cost": str(card.cost),
        "Tuning of its recipe and its teachers'": card.cost.tuning is not None and str(card.cost.tuning),
        "Best after": card.best_after is not None and f"{card.best_after:,} steps",
        "Reward shaping": card.shaping is not None and f"potential {_code(card.shaping)}{scale}",
        "Weights of reward terms": _values(card.reward_weights),
        "Teacher": card.teacher is not None and _code(card.teacher),
        "Options in training only": _values(card.training_options),
        "Later stages": bool(card.curriculum) and str(len(card.curriculum)),
        "Converted from a model of": card.conversion is not None and _code(card.conversion.saved_with),
        "Versions": _values(card.versions, " "),
    }
    return [(label, text) for label, text in facts.items() if text]


def _list(items: Iterable[tuple[str, str]]) -> str:
    return "\n".join(f"- {label}: {text}" for label, text in items)


def _values(values: Mapping[str, Any], separator: str = "=") -> str:
    return ", ".join(_code(f"{name}{separator}{value}") for name, value in values.items())


def _sizes(shape: Sequence[int] | Mapping[str, Sequence[int]]) -> str:
    if isinstance(shape, Mapping):
        return ", ".join(f"{_code(name)} {_sizes(size)}" for name, size in shape.items())
    return f"{' x '.join(map(str, shape)) or 1} numbers"


def _plain(text: str) -> str:
    """Return a text in one line, without control characters."""
    return printable(" ".join(text.split()))


def _code(text: object) -> str:
    return f"`{_plain(str(text)).replace('`', chr(39))}`"
