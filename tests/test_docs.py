"""The README and the pages in docs/: their examples run, what they name exists, and the site has all of them.

A fence says what its block is. `python` and `sh` are run, all of a page in one folder, in their order. `python mine.py`
and `toml mine.toml` are files for the blocks after them; `toml` alone is an excerpt of a recipe, and
`python docs/examples/hover.py NAME` one of a file. `text` is what something prints. `not run: REASON` is not run: its
commands are checked as far as they can be.
"""

import importlib
import importlib.util
import os
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import pytest
import typer.main
import yaml

from armctl.cli import app
from armctl.core.registration import environment_names
from armctl.policies import policy_names
from armctl.training.learners import learner_names, load_recipe, recipe_names

from .page_runner import LEARNING, SECONDS, page_runner

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
GROUPS = {f"armctl.{kind}" for kind in ("dataset_formats", "learners", "policies", "recipes", "tasks", "trackers")}


def name_of(page):
    return str(page.relative_to(ROOT).with_suffix(""))


each_page = pytest.mark.parametrize("page", PAGES, ids=name_of)


class Block(NamedTuple):
    """A fenced block of a page."""

    kind: str
    note: str
    text: str


def blocks(page):
    fences = re.findall(r"^```([^\n]*)\n(.*?)^```$", page.read_text(), re.MULTILINE | re.DOTALL)
    return [Block(*first.partition(" ")[::2], text) for first, text in fences]  # type: ignore[call-arg]


def to_run(page):
    """The blocks that are run or written, in their order."""
    return [block for block in blocks(page) if block.kind in ("python", "sh", "toml") and _is_used(block)]


def _is_used(block):
    if block.kind == "toml" and not block.note:
        return False
    return not block.note.startswith("not run: ") and " " not in block.note


def commands(text):
    """A shell block's commands, split into words, without comments."""
    lines = text.replace("\\\n", " ").splitlines()
    return [words for line in lines if (words := shlex.split(line, comments=True))]


@each_page
def test_commands_and_code_fit_into_80_columns(page):
    texts = [block.text for block in blocks(page) if block.kind in ("sh", "python")]
    assert not [line for text in texts for line in text.splitlines() if len(line) > 80]


@each_page
def test_every_block_says_what_it_is(page):
    for kind, note, text in blocks(page):
        assert kind in ("python", "sh", "toml", "text"), f"a fence without a kind: {text}"
        if kind == "text":
            assert not note
        elif "." in note and " " not in note:
            assert kind in ("python", "toml"), note
            assert Path(note).suffix == {"python": ".py", "toml": ".toml"}[kind], note
        else:
            assert not note or re.match(r"not run: \w+|\S+\.py \S+$", note), note
        if kind == "toml":
            tomllib.loads(text)
        if kind == "python" and note.startswith("not run"):
            compile(text, page.name, "exec")


@pytest.fixture(scope="module")
def run():
    with page_runner("-W", "error::DeprecationWarning", imports=LEARNING, OMP_NUM_THREADS="1") as runner:
        yield runner


@pytest.mark.slow
@pytest.mark.parametrize("page", [page for page in PAGES if to_run(page)], ids=name_of)
def test_examples_run(page, tmp_path, run):
    """With 10 episodes instead of 20, for which there are intervals too."""
    folder = tmp_path / "page"
    folder.mkdir()
    (folder / "docs").symlink_to(ROOT / "docs")
    steps: list[tuple[str, ...]] = []
    for kind, note, text in to_run(page):
        text = re.sub(r"\bepisodes([ =])20\b", r"episodes\g<1>10", text)
        if note:
            steps.append(("file", note, text))
        elif kind == "python":
            steps.append(("python", text))
        else:
            steps += [("command", *words) for words in commands(text)]
    run(folder, steps)


@each_page
def test_every_command_is_one_that_there_is(page):
    verbs: Any = typer.main.get_command(app)
    targets = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    for block in blocks(page):
        for words in commands(block.text) if block.kind == "sh" else ():
            match words:
                case ["armctl", verb, *arguments]:
                    _check(verbs.commands[verb], arguments)
                case ["make", *goals]:
                    assert set(goals) <= set(targets), goals
                case ["python", "-m", module, *_]:
                    assert importlib.util.find_spec(module), module
                case ["python", script, *_]:
                    assert (ROOT / script).exists(), script
                case [program, *_]:
                    assert program in ("cp", "docker", "mkdir", "pip", ".venv/bin/pip", "rerun", "source", "ssh"), words


def _check(verb, arguments):
    """That a verb's arguments can be parsed, and that the names in them exist; the reader's files need not."""
    for parameter in verb.params:
        parameter.callback = None
    given = verb.make_context(verb.name, list(arguments)).params
    env = given.get("env")
    assert env is None or ":" in env or env in gymnasium.registry, env
    named = [*(given.get("policies") or ()), *(given.get("agents") or ()), given.get("policy"), given.get("teacher")]
    for policy in (re.sub(r"^filtered\((.*?)\).*", r"\1", one).partition("[")[0] for one in named if one):
        assert re.search(r"[:/.]", policy) or policy in policy_names(), policy
    if "recipe" in given:
        assert given["recipe"].endswith(".toml") or given["recipe"] in [*recipe_names(), *learner_names()]


@each_page
def test_no_comment_is_continued_by_a_line_that_a_shell_would_run(page):
    assert re.findall(r"^ *#[^\n]*\\\n", page.read_text(), re.MULTILINE) == []


@each_page
def test_excerpts_are_what_the_code_says(page):
    renewed = imported("excerpts").renewed(page.read_text())
    assert page.read_text() == renewed, "python docs/excerpts.py makes the excerpts anew"


@each_page
def test_links_lead_somewhere(page):
    for link in re.findall(r"\]\(([^)]+)\)", _prose(page)):
        if link.startswith("https://"):
            continue
        file, _, heading = link.partition("#")
        target = (page.parent / file).resolve() if file else page
        assert target.exists(), link
        assert not heading or heading in _headings(target), link


def _headings(page):
    """The anchors that GitHub makes of a page's headings."""
    titles = re.findall(r"^#+ (.*)$", _prose(page), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", title).strip().lower().replace(" ", "-") for title in titles}


def _prose(page):
    return re.sub(r"^```.*?^```$", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)


@each_page
def test_names_and_paths_in_the_prose_exist(page):
    """Modules and attributes of armctl, environments, and files of the repository, as they stand in backticks."""
    for name in re.findall(r"`(armctl(?:\.\w+)+)[`(]", _prose(page)):
        assert name in GROUPS or _importable(name), name
    for env in re.findall(r"\barmctl/\w+-v\d+", page.read_text()):
        assert env in environment_names(), env
    folders = "baselines|benchmarks|docs|models|notebooks|rl|src|tests"
    for path in re.findall(rf"(?<![\w/.])((?:{folders})/[\w/.*-]*)", _prose(page)):
        found = list(ROOT.glob(path.rstrip("."))) if "*" in path else [ROOT / path.rstrip(".")]
        assert found, path
        assert all(one.exists() for one in found), path


def _importable(name):
    """Whether that is a module of armctl's, or what one has."""
    module, attributes = name, []
    while module:
        try:
            found = importlib.import_module(module)
            break
        except ModuleNotFoundError:
            module, _, attribute = module.rpartition(".")
            attributes.insert(0, attribute)
    for attribute in attributes:
        if not hasattr(found, attribute):
            return False
        found = getattr(found, attribute)
    return True


@pytest.mark.slow
def test_the_changelog_names_what_there_is_now():
    """The right column of its tables of renamed modules and names."""
    code = "".join(path.read_text() for part in ("src", "baselines", "rl") for path in (ROOT / part).rglob("*.py"))
    for new in re.findall(r"^\| `[^|]+\|([^|]+)\|$", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE):
        for name in re.findall(r"`([\w.]+)", new):
            known = _importable(name) if name.startswith("armctl.") else re.search(rf"\b{name.split('.')[-1]}\b", code)
            assert known, name


def test_the_layout_has_every_folder_and_file():
    tree, floors = [block.text for block in blocks(ROOT / "docs" / "layout.md") if block.kind == "text"][:2]
    there = {path.name for path in (ROOT / "src/armctl").iterdir() if not path.name.startswith(("_", "py.typed"))}
    assert {name.rstrip("/") for name in re.findall(r"^  ([\w/.]+)", tree, re.MULTILINE)} == there
    for name in re.findall(r"^([\w/]+)", tree, re.MULTILINE):
        assert (ROOT / name).is_dir(), name
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    assert floors.split("\n")[:-1] == next(one["layers"] for one in contracts if one["type"] == "layers")


def test_the_diagram_has_the_floors_of_today():
    diagram = imported("make_architecture")
    assert diagram.SVG.read_text() == diagram.drawing(), "python docs/make_architecture.py draws it"


def test_every_policy_is_said_what_it_sees():
    table = (ROOT / "docs" / "policies.md").read_text().split("may see |")[1].split("\n\n")[0]
    rows = re.findall(r"^\|([^|]+)\|[^|]+\|[^|]+\|$", table, re.MULTILINE)
    assert sorted(name for row in rows for name in re.findall(r"`(\w+)`", row)) == policy_names()


def test_every_disturbance_and_potential_is_in_the_pages():
    from armctl.envs import task_of

    tasks = [task_of(env) for env in environment_names() if env.startswith("armctl/")]
    for page, declared in (("robustness", "disturbances"), ("shaping", "potentials")):
        table = set(re.findall(r"^\| `(\w+)` \|", (ROOT / "docs" / f"{page}.md").read_text(), re.MULTILINE))
        assert {name for task in tasks for name in getattr(task, declared)} <= table


def test_every_option_of_an_environment_is_in_the_pages():
    import dataclasses

    from armctl.envs import task_of

    page = (ROOT / "docs" / "environments.md").read_text()
    for env in (env for env in environment_names() if env.startswith("armctl/")):
        for option in dataclasses.fields(task_of(env).options_type):
            assert f"`{option.name}`" in page, option.name


def test_every_recipe_names_a_learner_that_the_pages_explain():
    table = re.findall(r"^\| `(\w+)` \|", (ROOT / "docs" / "training.md").read_text(), re.MULTILINE)
    assert {load_recipe(name).learner for name in recipe_names()} <= set(table)
    assert set(learner_names()) <= set(table)


def test_every_page_is_in_the_site():
    """As are its parts, in the order in which they are read."""
    hooks = imported("hooks")
    entries = navigation()["nav"]
    parts = [name for part in entries for name in part]
    assert parts == ["Start", "Guide", "Your own", "Benchmarks", "Notebooks", "API", "Changelog"]
    shown = re.findall(r"'([\w/]+\.md)'", str(entries))
    assert len(shown) == len(set(shown))
    docs = {str(page.relative_to(ROOT / "docs")) for page in (ROOT / "docs").rglob("*.md")}
    assert set(shown) == docs | set(hooks.GUESTS) | set(hooks.NOTEBOOKS)


def test_the_site_needs_no_network():
    settings = navigation()
    assert settings["theme"]["font"] is False
    assert "repo_url" not in settings  # the theme would ask GitHub for stars


@pytest.mark.slow
def test_the_site_is_built_without_a_warning(tmp_path):
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", tmp_path]
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, env=environment, timeout=SECONDS)
    assert done.returncode == 0, done.stderr
    assert "WARNING" not in done.stderr
    pages = {path: path.read_text() for path in tmp_path.rglob("*.html")}
    for path, html in pages.items():
        assert not re.search(r"<(?:script|link|img)[^>]+(?:src|href)=\"?https?:", html), path
        assert "not run:" not in re.sub(r"<p>.*?</p>", "", html), path
    task, resolved = (pages[tmp_path / name / "index.html"] for name in ("add_a_task", "policies"))
    assert '<span class="filename">docs/examples/hover.py</span>' in task
    assert "https://github.com/armctl/armctl/blob/main/docs/examples/hover.py" in task
    assert 'href="../zoo/"' in resolved
    for path in tmp_path.glob("reference/*/index.html"):
        assert all(kinds == sorted(kinds, reverse=True) for kinds in kinds_of_members(pages[path]).values()), path


def kinds_of_members(html):
    """Return what a page of the API has, function, class or attribute, in their order, by module or class."""
    kinds: dict[str, list[str]] = {}
    for name, kind in re.findall(r'id="([\w.]+)" class="doc doc-heading">\s*<code class="[^"]*-(\w+)">', html):
        if kind != "method":
            kinds.setdefault(name.rpartition(".")[0], []).append(kind)
    assert kinds
    return kinds


def test_notes_of_fences_become_titles():
    shown = imported("hooks").NOTE.sub(imported("hooks").titled, "```python a.py\n```sh not run: why\n```text\n```\n")
    assert shown == '```python title="a.py"\n```sh\n```text\n```\n'


def navigation():
    """What mkdocs.yml says."""
    return yaml.safe_load((ROOT / "mkdocs.yml").read_text())


def imported(name):
    """A module in docs/."""
    sys.path.insert(0, str(ROOT / "docs"))
    try:
        return importlib.import_module(name)
    finally:
        sys.path.pop(0)
