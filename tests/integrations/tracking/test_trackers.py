"""Trainings in wandb, MLflow and TensorBoard, offline, as each library reads its own records."""

import contextlib
import io
import json
import logging
import os
import subprocess
import sys
from importlib.metadata import EntryPoint

import pandas as pd
import pytest
from PIL import Image
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from armctl.cli import completion
from armctl.core.errors import ConfigurationError
from armctl.integrations.tracking import load_tracker, tracked, tracker_names
from armctl.training.learners import load_learner, load_recipe

from ...command_line import armctl

TRACKERS = ("wandb", "mlflow", "tensorboard")
QUICK = {"worlds": 8, "batch_size": 64, "evaluation_every": 100, "validation_episodes": 2, "evaluation_episodes": 2}
COMMAND = ["train", "reach_ppo", "--shaping", "none", "--out", "run", "--set", "max_episode_steps=9"] + [
    word for name, value in QUICK.items() for word in ("--option", f"{name}={value}")
]


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    """A folder of nobody's: without an account, or records of other trainings."""
    folder = tmp_path_factory.mktemp("Tracked")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setenv("WANDB_MODE", "offline")
        patch.setenv("MLFLOW_DISABLE_TELEMETRY", "true")
        for name in ("WANDB_DATA_DIR", "WANDB_CACHE_DIR", "WANDB_CONFIG_DIR"):
            patch.setenv(name, str(folder / "wandb"))
        for name in ("MLFLOW_TRACKING_URI", "MLFLOW_EXPERIMENT_NAME", "WANDB_PROJECT", "WANDB_API_KEY"):
            patch.delenv(name, raising=False)
        levels = {name: logging.getLogger(name).level for name in ("mlflow", "alembic")}
        yield folder
        for name, level in levels.items():
            logging.getLogger(name).setLevel(level)


@pytest.fixture(scope="module")
def trained(home):
    """A training that was interrupted, and then resumed by the command line, with all trackers."""
    recipe = load_recipe("reach_ppo")
    recipe = recipe.changed(
        shaping=None, options=recipe.options | QUICK | {"steps": 256}, env_options={"max_episode_steps": 9}
    )
    said: list[str] = []
    with (
        contextlib.suppress(KeyboardInterrupt),
        tracked(TRACKERS, recipe, home / "run", 0, False, said.append) as on_evaluation,
    ):
        load_learner("ppo")(recipe, out=home / "run", seed=0, progress=False, on_evaluation=on_evaluation)
        raise KeyboardInterrupt
    assert [run.info.status for run in mlflow_runs(home)] == ["KILLED"]
    assert len(said) == len(TRACKERS), said
    options = [word for name in TRACKERS for word in ("--track", name)]
    done = armctl(*COMMAND, "--steps", "512", "--resume", *options, cwd=home)
    return home / "run", pd.read_csv(home / "run" / "curve.csv"), done.stderr


def mlflow_client(home):
    from mlflow import MlflowClient  # seconds, which the collection of all tests need not take

    return MlflowClient(f"sqlite:///{home / 'mlflow.db'}")


def mlflow_runs(home):
    client = mlflow_client(home)
    return client.search_runs([client.get_experiment_by_name("armctl").experiment_id])


def wandb_records(run):
    """All records of offline runs, oldest first: files of LevelDB's log format, after a header of 7 bytes."""
    from wandb.proto.wandb_internal_pb2 import Record  # takes a second

    for file in sorted((run / "tracking" / "wandb").glob("offline-run-*/*.wandb")):
        content, place, parts = file.read_bytes(), 7, b""
        while place < len(content):
            left = 32768 - place % 32768
            if left < 7:
                place += left
                continue
            length, kind = int.from_bytes(content[place + 4 : place + 6], "little"), content[place + 6]
            parts += content[place + 7 : place + 7 + length]
            place += 7 + length
            if kind in (1, 4):  # whole, or the last part
                yield Record.FromString(parts)
                parts = b""


@pytest.mark.slow
def test_each_tracker_says_once_where_the_run_is(trained):
    run, _, said = trained
    assert "failed" not in said
    assert "no video" not in said
    assert [sum(line.startswith(f"Tracking by {name}: ") for line in said.splitlines()) for name in TRACKERS] == [1] * 3
    assert f"wandb sync {run.resolve() / 'tracking' / 'wandb'}" in said
    assert f"tensorboard --logdir {run.resolve() / 'tracking' / 'tensorboard'}" in said


@pytest.mark.slow
def test_wandb_has_it_all(trained):
    run, curve, _ = trained
    records = list(wandb_records(run))
    begun = [record.run for record in records if record.HasField("run")]
    assert {one.run_id for one in begun} == {json.loads((run / "tracking" / "wandb.json").read_text())["run"]}
    assert len({one.start_time.ToNanoseconds() for one in begun}) == 2, "a part before and one after the interrupt"
    config = {item.key: json.loads(item.value_json) for one in begun for item in one.config.update}
    assert (config["learner"], config["seed"], config["options"]["worlds"]) == ("ppo", 0, 8)
    rows = [
        {(item.key or item.nested_key[0]): json.loads(item.value_json) for item in record.history.item}
        for record in records
        if record.HasField("history")
    ]
    rows_of_curve = [row for row in rows if "success" in row]
    for name in ("steps", "success", "return", "minutes"):
        assert [row[name] for row in rows_of_curve] == pytest.approx(list(curve[name]))
    assert any(row["steps"] == 512 and "final_success" in row for row in rows)
    (artifact,) = [record.artifact for record in records if record.HasField("artifact")]
    assert {entry.path for entry in artifact.manifest.contents} == {"agent.onnx", "agent.json", "curve.csv"}
    assert [file.stat().st_size for file in (run / "tracking").rglob("files/media/**/*.mp4")] == [
        (run / "tracking" / "agent.mp4").stat().st_size
    ]
    codes = [record.exit.exit_code for record in records if record.HasField("exit")]
    assert codes == [255, 0]


@pytest.mark.slow
def test_mlflow_has_it_all(trained, home):
    _, curve, _ = trained
    client = mlflow_client(home)
    (found,) = mlflow_runs(home)
    assert (found.info.status, found.info.run_name) == ("FINISHED", "run")
    told = found.data.params
    assert (told["learner"], told["seed"], told["options.worlds"], told["env_options.max_episode_steps"]) == (
        "ppo", "0", "8", "9",
    )  # fmt: skip
    for name in ("success", "return", "minutes"):
        history = client.get_metric_history(found.info.run_id, name)
        assert [(one.step, one.value) for one in history] == list(zip(curve.steps, curve[name], strict=True))
    artifacts = {
        file.path for folder in ("agent", "video") for file in client.list_artifacts(found.info.run_id, folder)
    }
    assert artifacts == {"agent/agent.onnx", "agent/agent.json", "agent/curve.csv", "video/agent.mp4"}


@pytest.mark.slow
def test_tensorboard_has_it_all(trained):
    run, curve, _ = trained
    events = EventAccumulator(str(run / "tracking" / "tensorboard"), size_guidance={"tensors": 0, "images": 0})
    events.Reload()
    texts = {
        tag: [one.tensor_proto.string_val[0].decode() for one in events.Tensors(tag)]
        for tag in events.Tags()["tensors"]
    }
    (config,) = texts["config/text_summary"]
    assert json.loads(config.strip("`\n"))["options"]["worlds"] == 8
    assert json.loads(texts["agent/text_summary"][0].strip("`\n")) == json.loads((run / "agent.json").read_text())
    assert [text.strip("`\n") for text in texts["ended/text_summary"]] == ["interrupted", "finished"]
    for name in ("success", "return"):
        found = [(one.step, one.value) for one in events.Scalars(f"held-out/{name}")]
        assert found == [
            (steps, pytest.approx(value, rel=1e-6)) for steps, value in zip(curve.steps, curve[name], strict=True)
        ]
    (video,) = events.Images("video")
    with Image.open(io.BytesIO(video.encoded_image_string)) as gif:
        assert (gif.format, gif.size) == ("GIF", (video.width, video.height))
        assert getattr(gif, "n_frames", 0) > 1


ALONE = """
from pathlib import Path
from armctl.integrations.tracking.wandb import WandbTracker

tracker = WandbTracker("alone", Path.cwd(), {}, None)
tracker.log(3, {"success": 0.5})
tracker.finish("finished")
print(tracker.where)
"""


@pytest.mark.slow
@pytest.mark.parametrize("account", [{}, {"WANDB_API_KEY": "0" * 40}])
def test_without_account_or_network_wandb_works_offline(account, home, tmp_path):
    nowhere = {"WANDB_BASE_URL": "http://127.0.0.1:9", "WANDB_INIT_TIMEOUT": "2", "NETRC": str(tmp_path / "none")}
    known = {name: value for name, value in os.environ.items() if name != "WANDB_MODE"}
    done = subprocess.run(
        [sys.executable, "-c", ALONE], cwd=tmp_path, env=known | nowhere | account, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    (file,) = tmp_path.glob("wandb/offline-run-*/*.wandb")
    assert done.stdout.splitlines()[-1] == f"wandb sync {file.parent}"


@pytest.mark.parametrize(
    ("name", "package", "extra"),
    [("wandb", "wandb", "wandb"), ("mlflow", "mlflow", "mlflow"), ("tensorboard", "torch.utils.tensorboard", "rl")],
)
def test_a_missing_extra_is_named_in_a_line(name, package, extra, monkeypatch):
    monkeypatch.setitem(sys.modules, package, None)
    monkeypatch.delitem(sys.modules, f"armctl.integrations.tracking.{name}", raising=False)
    with pytest.raises(ConfigurationError) as raised:
        load_tracker(name)
    assert f"tracking by {name} needs {package}: pip install 'armctl-suite[{extra}]'" in str(raised.value)
    assert "\n" not in str(raised.value)


def test_a_misspelt_tracker_is_refused_before_anything_is_written(home):
    done = armctl(*COMMAND[:2], "--track", "wandbb", "--out", "never", cwd=home, check=False)
    assert done.returncode == 2
    assert "no tracker 'wandbb'. Did you mean 'wandb'? There are: mlflow, tensorboard, wandb" in " ".join(
        done.stderr.split()
    )
    assert not (home / "never").exists()


def test_what_is_shipped():
    assert set(TRACKERS) <= set(tracker_names())
    assert completion.trackers("w") == ["wandb"]


def test_a_strangers_tracker_that_cannot_be_loaded_is_named(monkeypatch):
    entries = {"mine": EntryPoint("mine", "no_such_module:Mine", "armctl.trackers")}
    monkeypatch.setattr("armctl.core.registration.installed", lambda group: Offered(entries))
    with pytest.raises(ConfigurationError, match="cannot load the tracker mine: ModuleNotFoundError"):
        load_tracker("mine")


class Offered(dict):
    names = property(dict.keys)
