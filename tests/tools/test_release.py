"""The sealed test: drawn by nobody's choice, and played once by all that is published."""

import csv
import json
import shutil
from pathlib import Path

import pytest
import release as tool
import zoo
from typer.testing import CliRunner

from armctl.agents import read_card
from armctl.core import seeds
from armctl.core.seeds import TEST_SEED, VALIDATION_SEED
from armctl.policies.trainings import card_path
from armctl.tasks.reach.layout_pool import POOL_FILE, read_pool, write_pool
from armctl.training.trials import read_trials

ROOT = Path(__file__).parents[2]


@pytest.fixture
def release(tmp_path, monkeypatch):
    """The tool with files of its own, and one agent and one expert to publish."""
    tool.checksum_of_episodes.cache_clear()
    agents = tmp_path / "agents"
    agents.mkdir()
    for suffix in (".json", ".onnx"):
        shutil.copy(card_path("reach_ppo").with_suffix(suffix), agents / f"reach_ppo{suffix}")
    card = read_card(agents / "reach_ppo.json")
    few = card.evaluation.model_copy(update={"episodes": 3, "seed": 5})
    trained = card.model_copy(update={"evaluation": few, "development": None})
    (agents / "reach_ppo.json").write_text(trained.model_dump_json())
    (tmp_path / "seeds.py").write_text(Path(seeds.__file__).read_text())
    shutil.copy(tool.GOLDEN, tmp_path / "golden.json")
    monkeypatch.setattr(tool, "EPISODES", 2)
    monkeypatch.setattr(tool, "PLAYS", tmp_path / "plays.csv")
    monkeypatch.setattr(tool, "SEEDS", tmp_path / "seeds.py")
    monkeypatch.setattr(tool, "GOLDEN", tmp_path / "golden.json")
    monkeypatch.setattr(tool, "environment_names", lambda: ["armctl/ArmReach-v0"])
    monkeypatch.setattr(tool, "line_up", lambda env: ["reach_ik", "reach_ppo"])
    monkeypatch.setattr(zoo, "HOME", tmp_path)
    monkeypatch.setattr(seeds, "TEST_SEED", 77)
    return tool


def run(release, *arguments):
    return CliRunner().invoke(release.app, arguments)


def rows(release):
    return list(csv.DictReader(release.PLAYS.open()))


def test_each_policy_plays_the_test_once(release, tmp_path):
    assert run(release, "play").exit_code == 0
    assert [(row["policy"], row["seed"], row["episodes"]) for row in rows(release)] == [
        ("reach_ppo", "77", "3"), ("reach_ik", "77", "2"),
    ]  # fmt: skip
    card = read_card(tmp_path / "agents" / "reach_ppo.json")
    assert (card.evaluation.seed, card.development.seed, card.judgement.seed) == (77, 5, 5)
    assert "100.0% of 3" in (tmp_path / "README.md").read_text()
    before = (tmp_path / "agents" / "reach_ppo.json").read_bytes()
    assert run(release, "play").exit_code == 0
    refused = run(release, "play", "reach_ppo")
    assert refused.exit_code != 0
    assert "A policy plays it once" in refused.output
    assert len(rows(release)) == 2
    assert (tmp_path / "agents" / "reach_ppo.json").read_bytes() == before


def test_only_other_episodes_are_a_reason_to_play_again(release):
    run(release, "play")
    again = run(release, "play", "--again", "I did not like it")
    assert again.exit_code == 0
    assert len(rows(release)) == 2
    golden = json.loads(release.GOLDEN.read_text())
    golden["armctl/ArmReach-v0 {} reach_ik"]["lengths"][0] += 1
    release.GOLDEN.write_text(json.dumps(golden))
    release.checksum_of_episodes.cache_clear()
    refused = run(release, "play")
    assert refused.exit_code != 0
    assert "a second play needs --again WHY" in " ".join(refused.output.split())
    assert run(release, "play", "--again", "reach_ik plans otherwise").exit_code == 0
    assert [row["again"] for row in rows(release)] == ["", "", *["reach_ik plans otherwise"] * 2]


def test_another_network_of_a_name_plays_for_itself(release, tmp_path):
    run(release, "play", "reach_ppo")
    path = tmp_path / "agents" / "reach_ppo.json"
    path.with_suffix(".onnx").write_bytes(card_path("reach_sac").with_suffix(".onnx").read_bytes())
    few = read_card(path).evaluation.model_copy(update={"seed": 5})
    path.write_text(read_card(card_path("reach_sac")).model_copy(update={"evaluation": few}).model_dump_json())
    assert run(release, "play", "reach_ppo").exit_code == 0
    assert len({row["sha256"] for row in rows(release)}) == 2


def test_a_test_is_drawn_after_all_have_played_the_last_one(release, tmp_path, monkeypatch):
    monkeypatch.setattr(release, "POOL_FILE", tmp_path / "pool.npz")
    write_pool(read_pool(POOL_FILE), tmp_path / "pool.npz")
    monkeypatch.setattr(release, "with_seeds", lambda pool, seeds, processes: pool)
    refused = run(release, "draw")
    assert refused.exit_code != 0
    assert "2 published policies have not played the test of seed 77" in " ".join(refused.output.split())
    assert f"TEST_SEED = {TEST_SEED}\n" in release.SEEDS.read_text()
    drawn = []
    for force in ([], ["--force"]):
        if not force:
            run(release, "play")
        assert run(release, "draw", *force).exit_code == 0
        (line,) = [line for line in release.SEEDS.read_text().splitlines() if line.startswith("TEST_SEED = ")]
        drawn.append(int(line.removeprefix("TEST_SEED = ")))
    assert drawn[0] != drawn[1]
    assert all(release.SMALLEST_SEED <= seed < VALIDATION_SEED for seed in drawn)
    assert "DEVELOPMENT_SEED = 2026\n" in release.SEEDS.read_text()


@pytest.mark.slow
def test_published_agents_are_of_the_present_test():
    """All of one seed, in the table as well; those that were trained since the last release are of none."""
    for path in sorted((ROOT / "rl" / "agents").rglob("*.json")):
        card = read_card(path)
        assert card.evaluation.seed == TEST_SEED, f"{path.stem}: run python tools/release.py play"
        assert f"| {card.evaluation.success_rate:.1%} of {card.evaluation.episodes:,} |" in zoo.table()


@pytest.mark.slow
def test_every_published_policy_has_its_trials_in_the_ledger():
    """Experts too, and agents that look ahead; of what nobody recorded, it says so."""
    known = {row["recipe"] for row in read_trials(ROOT / "rl" / "trials.csv")}
    names = {read_card(one.card).recipe if one.card else one.name for one in tool.published()} - {"random"}
    assert names > {"bridge_moving_imagined", "obstacles_imagined", "bridge_ompl", "reach_ik"}
    assert names <= known


def test_tasks_of_others_are_not_published(monkeypatch):
    """Other packages may be installed beside armctl, and other tests may have registered theirs in this process."""
    monkeypatch.setattr(tool, "environment_names", lambda: ["mine/Hover-v0"])
    assert all(one.card for one in tool.published())
