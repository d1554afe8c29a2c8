"""Recipes, which describe trainings; learners, which follow them; exporters of models; and how all are found.

A package offers learners under the entry-point group `armctl.learners`, packages of recipes (`*.toml`) under
`armctl.recipes`, and exporters, by the suffix of the files that they read, under `armctl.exporters`.
"""

import contextlib
import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Annotated, Any, Protocol, TypeVar

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, field_validator

from armctl import DEFAULT_ENV
from armctl.agents import FILES, AgentCard
from armctl.agents.costs import TuningCost
from armctl.core.errors import ConfigurationError, unknown_name
from armctl.core.files import checked_name, read_toml
from armctl.core.options import checked_model, make_options
from armctl.core.registration import check_named, files_within, installed, load_installed
from armctl.policies.configuration import is_code

LEARNERS, RECIPES, EXPORTERS = "armctl.learners", "armctl.recipes", "armctl.exporters"

TrainingSeed = Annotated[int, Field(ge=0, lt=2**32)]
Options = TypeVar("Options")


class Stage(BaseModel):
    """Options and weights that replace a recipe's from some share of a training's steps on."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    after: Annotated[float, Field(gt=0, lt=1)]
    """Share of the steps that are made before."""
    training_options: dict[str, Any] = {}
    reward_weights: dict[str, FiniteFloat] = {}


class Recipe(BaseModel):
    """Everything that defines a training, except its seed."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    name: str
    """Name of its file, without `.toml`; the default folder of a training begins with it."""
    learner: str
    env: str
    env_options: dict[str, Any] = {}
    """Options of the environment that the agent acts in."""
    training_options: dict[str, Any] = {}
    """Options of the environment in training only: the agent is evaluated without them."""
    shaping: str | None = None
    """Potential for potential-based reward shaping (see `armctl.shaping`); None for no shaping."""
    shaping_scale: FiniteFloat = 1.0
    """Reward per unit of the potential."""
    reward_weights: dict[str, FiniteFloat] = {}
    """Weights of the task's own reward terms in training; 1 where not named."""
    curriculum: list[Stage] = []
    """Later stages of the training, which differ in `training_options` and `reward_weights`."""
    teacher: str | None = None
    """The policy to learn from: any that `armctl.make_policy` takes."""
    filter: dict[str, Any] | bool = False
    """Safety filter of the actions in training, and then of the agent's: true, or its options."""
    seeds: Annotated[list[TrainingSeed], Field(min_length=1)] = [0]
    """Training seeds of the published results."""
    options: dict[str, Any] = {}
    """Options of the learner, such as `steps`."""
    tune: dict[str, Any] = {}
    """The search space of `armctl tune` (see `armctl.core.search_space`), which a training does not use."""
    tuned: TuningCost | None = None
    """The search by which `armctl tune` has found these values."""

    @property
    def options_in_training(self) -> dict[str, Any]:
        """All options of the environment in training."""
        return self.env_options | self.training_options

    @property
    def filter_options(self) -> dict[str, Any] | None:
        """Options of the safety filter; None if there is none."""
        if isinstance(self.filter, dict):
            return self.filter
        return {} if self.filter else None

    def at_share(self, share: float) -> "Recipe":
        """Return the recipe with the options and weights that hold after a share of the training's steps."""
        begun_stages = [stage for stage in self.curriculum if stage.after <= share]
        return self.model_copy(update=begun_stages[-1].model_dump(exclude={"after"})) if begun_stages else self

    @property
    def stages(self) -> list["Recipe"]:
        """The recipe as it is at first, and in each stage of its curriculum."""
        return [self.at_share(share) for share in (0.0, *(stage.after for stage in self.curriculum))]

    @field_validator("curriculum")
    @classmethod
    def _in_order(cls, stages: list[Stage]) -> list[Stage]:
        if any(later.after <= earlier.after for earlier, later in itertools.pairwise(stages)):
            raise ValueError("stages should be in the order in which they begin")
        return stages

    def changed(self, **changes: Any) -> "Recipe":
        """Return the recipe with other values. Raises `ConfigurationError`."""
        return _recipe({**self.model_dump(), **changes}, f"recipe {self.name}, as changed")

    def read_options(self, options_type: type[Options]) -> Options:
        """Return the learner's options, checked by a class made with `armctl.core.options.options`.

        Raises `ConfigurationError` for an unknown name or an invalid value.
        """
        return make_options(options_type, self.options, f"option of {self.learner}")


Callback = Callable[[Mapping[str, float]], object] | None
"""Receiver of rows of a learning curve, by `armctl.study.curves.CURVE_COLUMNS`; what it raises ends the training."""


class Learner(Protocol):
    """Trains an agent into the folder `out`, or resumes the training there.

    `on_evaluation` is called with each held-out evaluation of this call, as soon as `curve.csv` has it.
    """

    def __call__(  # noqa: D102
        self,
        recipe: Recipe,
        *,
        out: Path,
        seed: int,
        resume: bool = False,
        progress: bool = True,
        on_evaluation: Callback = None,
    ) -> AgentCard: ...


@dataclass(frozen=True)
class ModelExport:
    """Another library's model, and the agent to make of it."""

    model: Path
    env: str
    """Environment that the model was trained in."""
    out: Path
    """The agent's graph (`.onnx`); its card is beside it."""
    env_options: Mapping[str, Any] = field(default_factory=dict)
    normalisation: Path | None = None
    """File of the observations' statistics; None: the exporter looks beside the model; a path named `none`: none."""
    algorithm: str | None = None
    """Algorithm that trained the model; None: as its file tells."""
    trust: bool = False
    """Permission to load what could run code."""
    overwrite: bool = False
    """Permission to replace an agent of that name."""


Exporter = Callable[[ModelExport], AgentCard]
"""Turns another library's model into an agent, and returns its card."""


def learner_names() -> list[str]:
    """Names of all installed learners."""
    return sorted(installed(LEARNERS).names)


def load_learner(name: str) -> Learner:
    """Return the installed learner of that name. Raises `ConfigurationError`, also without the extra `rl`."""
    return load_installed(LEARNERS, name, "learner", extra_for="training")  # type: ignore[no-any-return]


def load_exporter(model: Path) -> Exporter:
    """Return the installed exporter of files like this model's, by its suffix. Raises `ConfigurationError`."""
    entries, suffix = installed(EXPORTERS), model.suffix.removeprefix(".")
    if suffix not in entries.names:
        allowed = ", ".join(f".{name}" for name in sorted(entries.names))
        raise ConfigurationError(f"{model} cannot be exported: models are files {allowed or 'of no kind'}")
    return load_installed(EXPORTERS, suffix, "exporter", extra_for="exporting")  # type: ignore[no-any-return]


def recipe_names() -> list[str]:
    """Names of all installed recipes."""
    return sorted(files_within(RECIPES, ".toml"))


def readable_recipes() -> list[Recipe]:
    """Return all installed recipes but those of other packages that cannot be read."""
    recipes = []
    for name in recipe_names():
        with contextlib.suppress(ConfigurationError):
            recipes.append(load_recipe(name))
    return recipes


def load_recipe(name: str | Path, env: str | None = None, teacher: str | None = None) -> Recipe:
    """Return a recipe by its name, by its file's path, or by its learner and environment.

    `env` and `teacher` replace the recipe's own, and have to if these are code (`module:name`): a file runs none. A
    learner's name without `env` means `DEFAULT_ENV`. Of several recipes for an environment, the one with the shortest
    name is taken, which is the plain one; without any, the learner's defaults are. Raises `ConfigurationError`.
    """
    installed = files_within(RECIPES, ".toml")
    if Path(name).suffix == ".toml":
        recipe = _read(Path(name), Path(name).stem)
        if env is None:
            check_named(recipe.env, f"the recipe {name}", "--env")
        taught_by = recipe.teacher if teacher is None else None
        if taught_by is not None and Path(taught_by).suffix not in FILES and is_code(taught_by):
            check_named(taught_by, f"the recipe {name}", "--teacher")
    elif str(name) in installed:
        recipe = _read(installed[str(name)], str(name))
    elif name in learner_names():
        recipe = _recipe_of(str(name), env or DEFAULT_ENV)
    else:
        raise unknown_name("recipe", name, [*installed, *learner_names(), "path/to/recipe.toml"])
    overrides = {"env": env, "teacher": teacher}
    return recipe.changed(**{key: value for key, value in overrides.items() if value is not None})


def _recipe_of(learner: str, env: str) -> Recipe:
    suited = [recipe for recipe in readable_recipes() if (recipe.learner, recipe.env) == (learner, env)]
    plain = Recipe(name=learner, learner=learner, env=env)
    return min(suited, key=lambda recipe: len(recipe.name), default=plain)


def _read(file: Traversable, name: str) -> Recipe:
    return _recipe({"name": name, **read_toml(file, "recipe")}, str(file))


def _recipe(values: dict[str, Any], source: str) -> Recipe:
    checked_name("recipe", str(values.get("name")))
    return checked_model(Recipe, values, "recipe", source)
