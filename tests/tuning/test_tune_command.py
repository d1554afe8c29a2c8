"""The verb `tune`, and its page."""

import json

import pytest

from tests.command_line import armctl


@pytest.fixture(scope="module")
def tuned(tmp_path_factory):
    """What a tuning prints, and where it was."""
    folder = tmp_path_factory.mktemp("tuned")
    arguments = ["reach_mpc", "--trials", "6", "--episodes", "2"]
    return armctl("tune", *arguments, "--format", "json", cwd=folder), folder


@pytest.mark.slow
def test_it_prints_the_present_and_the_best_values(tuned):
    done, folder = tuned
    told = json.loads(done.stdout)
    rows = {row["values"]: row for row in told["values"]}
    assert rows["present"]["trial"] == 0
    assert rows["present"]["options.problem.horizon"] == 20
    best = rows.get("best", rows["present"])
    assert best["return"] >= rows["present"]["return"]
    assert ("best" in rows) == (folder / "tuned/reach_mpc/reach_mpc_tuned.toml").exists()


@pytest.mark.slow
def test_the_same_command_again_plays_nothing(tuned):
    done, folder = tuned
    ledger = (folder / "tuned/reach_mpc/trials.csv").read_text()
    again = armctl("tune", "reach_mpc", "--trials", "6", "--episodes", "2", "--format", "json", cwd=folder)
    assert json.loads(again.stdout) == json.loads(done.stdout)
    assert (folder / "tuned/reach_mpc/trials.csv").read_text() == ledger


@pytest.mark.slow
@pytest.mark.browser
def test_the_page_shows_all_plots_without_the_network(chromium, tuned):
    _, folder = tuned
    page, said, asked = chromium.new_page(viewport={"width": 1100, "height": 900}), [], []
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on("request", lambda request: asked.append(request.url))
    page.goto((folder / "tuned/reach_mpc/tuning.html").as_uri())
    page.wait_for_selector(".js-plotly-plot .main-svg")
    page.wait_for_function("document.querySelectorAll('.js-plotly-plot .main-svg').length >= 6")
    heads = page.locator("figure h3").all_inner_texts()
    wide = page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
    assert said == []
    assert [url for url in asked if not url.startswith(("file:", "data:"))] == []
    assert {"History", "Options", "Together", "What matters", "Curves", "Times"} == set(heads)
    assert wide


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["reach_mcp"], "Did you mean 'reach_mpc'"),
        (["reach_mpc", "--score", "winning"], "There are: return, success"),
        (["reach_mpc", "--hours", "-1"], "hours must be more than 0"),
        (["reach_mpc", "--on", "dask"], "no engine 'dask'"),
        (["reach_bc"], "add a table [tune]"),
    ],
)
def test_what_cannot_be_tuned_is_told(tmp_path, arguments, message):
    done = armctl("tune", *arguments, cwd=tmp_path, check=False)
    assert done.returncode == 2
    assert message in " ".join(done.stderr.split())
    assert not list(tmp_path.iterdir())
