"""Names are nouns, and docstrings say at once what they describe.

Pronouns, adverbs and participles are not names by themselves. The docstring of a value begins with a noun, that of a
function with a verb.
"""

import ast
import functools
import re
from pathlib import Path

import pytest

HOME = Path(__file__).parents[1]
CORE = HOME / "src" / "armctl"
PACKAGES = [
    *(CORE / name for name in ("kernels", "kinematics", "planning", "control", "robots", "robot_description", "scene")),
    *(CORE / name for name in ("simulation", "tasks", "disturbances", "shaping", "envs", "policies", "agents")),
    *(
        CORE / name
        for name in (
            "core",
            "episodes",
            "rollout",
            "runtime",
            "stats",
            "study",
            "verdict",
            "environments.py",
            "__init__.py",
        )
    ),
    *(CORE / name for name in ("cli", "datasets", "estimation", "integrations", "judging", "remote", "report")),
    *(CORE / name for name in ("training", "tuning", "viewer")),
    *(HOME / "baselines", HOME / "benchmarks", HOME / "rl", HOME / "tools"),
]
"""Packages whose renaming is done."""

NOT_NAMES = re.compile(
    "_*(?:after|alike|alone|asked|before|begun|both|drawn|earned|ended|felt|found|given|here|its|known|lacking|late|"
    "least|least_.*|left|look|made|most|most_.*|now|one|own|paced|paid|played|said|seen|shown|slower|there|told|"
    "wanted|what)_*",
    re.IGNORECASE,
)
SIDES = (
    *("kernels/bridge.py", "kernels/planar.py", "kernels/rays.py"),
    *("planning/cost_to_go.py", "planning/time_to_go.py", "robots/rover.py", "scene/bridge_map.py"),
    *("tasks/bridge/observation.py", "tasks/bridge/planar.py"),
)
"""Files in which `left` is a side, or the direction across what is ahead."""
ALLOWED = {(CORE / file, "left") for file in SIDES} | {(CORE / "training/learners.py", "after")}
"""Words that are names in a file: sides, and a key of recipes."""

WORLDS = "worlds"
"""The word of options and stored columns for a number of worlds. Inside, the number is `num_envs`."""
PUBLIC_WORLDS = {
    *(CORE / file for file in ("cli/evaluate.py", "cli/play.py")),
    *(
        CORE / file
        for file in ("episodes/record.py", "runtime/provenance.py", "study/options.py", "study/reproduce.py")
    ),
    *(CORE / file for file in ("study/reproduce.py", "rollout/loop.py", "verdict/decision_summary.py")),
    *(HOME / "rl" / file for file in ("algorithms/plan_bc.py", "algorithms/sac.py", "algorithms/td_mpc2.py")),
    *(HOME / "rl" / file for file in ("algorithms/imagined_dagger.py", "data/demonstrations.py", "run/options.py")),
    *(HOME / "benchmarks" / file for file in ("planar.py", "soak.py", "throughput.py")),
}
"""Files with that option or column."""

QUESTION = "how|what|when|where|whether|which|who|why"
PREPOSITION = (
    "against|among|as|at|before|behind|below|beside|between|but|by|during|for|from|in|into|of|on|over|per|since|than|to|"
    "under|until|with|within|without"
)
NO_OPENING = re.compile(rf"(?:{QUESTION}|{PREPOSITION})\b", re.IGNORECASE)
NO_OPENING_OF_FUNCTIONS = re.compile(rf"(?:{QUESTION}|{PREPOSITION}|a|an|the)\b", re.IGNORECASE)

Function = ast.FunctionDef | ast.AsyncFunctionDef


def bound_names(nodes):
    """Yield (line, name) of all names that a module binds, attributes of `self` included."""
    for node in nodes:
        match node:
            case ast.Name(id=name, ctx=ast.Store()):
                yield node.lineno, name
            case ast.Attribute(value=ast.Name(id="self"), attr=name, ctx=ast.Store()):
                yield node.lineno, name
            case ast.arg(arg=name):
                yield node.lineno, name
            case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name) | ast.ClassDef(name=name):
                yield node.lineno, name
            case ast.alias(asname=str(name)) if name:
                yield node.lineno, name
            case ast.ExceptHandler(name=str(name)) | ast.MatchAs(name=str(name)) | ast.MatchStar(name=str(name)):
                yield node.lineno, name


def counts_of_worlds(nodes):
    """Yield lines at which `worlds` is a number by its annotation."""
    for node in nodes:
        match node:
            case ast.arg(arg=name, annotation=ast.expr() as annotation) if name == WORLDS:
                pass
            case ast.AnnAssign(target=ast.Name(id=name), annotation=annotation) if name == WORLDS:
                pass
            case _:
                continue
        if re.match(r"(?:Annotated\[)?(?:int|Count)\b", ast.unparse(annotation)):
            yield node.lineno


def docstrings(nodes):
    """Yield (line, text, forbidden opening) of docstrings: of modules, classes, functions, and beneath values."""
    for node in nodes:
        if isinstance(node, Function) and ast.get_docstring(node):
            is_property = any("property" in ast.unparse(decorator) for decorator in node.decorator_list)
            yield node.lineno, ast.get_docstring(node), NO_OPENING if is_property else NO_OPENING_OF_FUNCTIONS
        elif isinstance(node, ast.Module | ast.ClassDef):
            if text := ast.get_docstring(node):
                yield getattr(node, "lineno", 1), text, NO_OPENING
            for value, following in zip(node.body, node.body[1:], strict=False):
                if isinstance(value, ast.Assign | ast.AnnAssign):
                    match following:
                        case ast.Expr(value=ast.Constant(value=str(words))):
                            yield following.lineno, words, NO_OPENING


def nodes_of(code):
    return list(ast.walk(ast.parse(code)))


@functools.cache
def findings(path):
    """Return what `bound_names`, `counts_of_worlds` and `docstrings` find in a file."""
    nodes = nodes_of(path.read_text())
    return tuple(tuple(find(nodes)) for find in (bound_names, counts_of_worlds, docstrings))


def files(package):
    return sorted(package.rglob("*.py")) if package.is_dir() else [package]


@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: package.name)
def test_names_are_nouns(package):
    refused = [
        f"{path.relative_to(HOME)}:{line}: {name}"
        for path in files(package)
        for line, name in findings(path)[0]
        if NOT_NAMES.fullmatch(name) and (path, name) not in ALLOWED
    ]
    assert not refused, "\n".join(["not names by themselves:", *refused])


@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: package.name)
def test_a_number_of_worlds_is_called_num_envs(package):
    refused = [
        f"{path.relative_to(HOME)}:{line}"
        for path in files(package)
        for line in findings(path)[1]
        if path not in PUBLIC_WORLDS
    ]
    assert not refused, "\n".join(["`worlds` is a number there:", *refused])


@pytest.mark.one_case
@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: package.name)
def test_docstrings_begin_with_a_noun_or_a_verb(package):
    refused = [
        f"{path.relative_to(HOME)}:{line}: {text.splitlines()[0]}"
        for path in files(package)
        for line, text, no_opening in findings(path)[2]
        if no_opening.match(text)
    ]
    assert not refused, "\n".join(["fragments:", *refused])


def test_exceptions_are_used():
    unused = [(path.name, name) for path, name in ALLOWED if name not in {bound for _, bound in findings(path)[0]}]
    assert not unused
    assert all(findings(path)[1] for path in PUBLIC_WORLDS)


@pytest.mark.parametrize(
    "code",
    [
        "found = 1",
        "_known, x = 1, 2",
        "def f(told): pass",
        "def look(): pass",
        "class A:\n    what: int",
        "class A:\n    def __init__(self): self._own = 1",
        "[one for one in ()]",
        "OWN = 1",
        "def f(least_time): pass",
    ],
)
def test_bound_words_are_recognised(code):
    assert any(NOT_NAMES.fullmatch(name) for _, name in bound_names(nodes_of(code)))


@pytest.mark.parametrize(
    "code",
    [
        '"""What is shown."""',
        'x = 1\n"""Of each search, s."""',
        'class A:\n    x: int\n    """Whether it is."""',
        'def f():\n    """The length, m."""',
        'class A:\n    @property\n    def f(self):\n        """From start to end, m."""',
    ],
)
def test_fragments_are_recognised(code):
    assert any(no_opening.match(text) for _, text, no_opening in docstrings(nodes_of(code)))
