"""Collections by workers of this machine: the same dataset, and nothing that was finished is lost."""

import os
import signal
import subprocess
from typing import Any

import pytest

from armctl.core.errors import ConfigurationError
from armctl.datasets.collect import collect
from armctl.datasets.minari import read_demonstrations
from armctl.episodes import PolicyFailed
from armctl.runtime.workers import WorkersFailed

from ..command_line import armctl
from .collections_of_random import ARMCTL, COMMAND, EPISODES, SHORT, same_dataset, wait_for_episodes, worlds


@pytest.mark.slow
@pytest.mark.parametrize("policy", ["random", "reach_ppo", "reach_ik"])
def test_workers_record_what_one_process_records(policy, tmp_path):
    """Also with another interface than the policy's own in a comparison, and with rewards of another scale."""
    options = SHORT | {"reward_scale": 0.5} | ({"actions": "normalized"} if policy == "random" else {})
    given: dict[str, Any] = {"episodes": 21, "env_options": options}
    seen = []
    alone = collect(policy, out=tmp_path / "alone", **given)
    workers = collect(policy, out=tmp_path / "workers", worlds=2, workers=2, progress=seen.append, **given)
    assert seen == list(range(1, 22))
    assert (workers.episodes, workers.steps, workers.successes) == (21, alone.steps, alone.successes)
    assert same_dataset(tmp_path / "alone", tmp_path / "workers")


@pytest.mark.slow
def test_what_one_process_began_workers_finish(interrupted, whole):
    assert collect("random", episodes=9, out=interrupted, env_options=SHORT, workers=2).resumed == 5
    assert same_dataset(interrupted, whole)


@pytest.mark.slow
def test_ctrl_c_keeps_what_workers_have_finished_and_the_same_command_resumes(uninterrupted, tmp_path):
    """Sent to all processes, as a terminal does."""
    command = [*COMMAND, "--worlds", "2", "--workers", "2", "--out", tmp_path / "here-v0"]
    begun = ["nice", "-n", "3", ARMCTL, *command]  # so that it cannot finish before this process gets to interrupt it
    with subprocess.Popen(begun, stdout=-1, stderr=-1, text=True, start_new_session=True) as process:
        wait_for_episodes(process, tmp_path / "here-v0", 10)
        os.killpg(process.pid, signal.SIGINT)
        output, errors = process.communicate(timeout=600)
    assert process.returncode == 130, errors
    assert "The same command resumes" in output
    assert "Traceback" not in errors
    assert 10 <= len(read_demonstrations(tmp_path / "here-v0", worlds())) < EPISODES
    again = armctl(*command, cwd=tmp_path)
    assert "were there already" in again.stdout
    assert same_dataset(tmp_path / "here-v0", uninterrupted)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("end", "error", "says"),
    [("raise RuntimeError('tired')", PolicyFailed, "tired"), ("os._exit(1)", WorkersFailed, "a worker process died")],
)
def test_what_ends_in_a_worker_is_told_and_finished_episodes_are_kept(end, error, says, tmp_path):
    """Once it plays episode 12; without that, the same call resumes."""
    tired = tmp_path / "tired"
    tired.touch()
    module = tmp_path / "ends_in_a_worker.py"
    module.write_text(
        "import os\nimport armctl\n\n@armctl.sees('state')\ndef ending(env):\n"
        "    policy = armctl.make_policy('random', env)\n    plain = policy.act\n"
        f"    def act(observations):\n        if env.episodes.max() >= 12 and os.path.exists({str(tired)!r}):\n"
        f"            {end}\n        return plain(observations)\n    policy.act = act\n    return policy\n"
    )
    given = {"episodes": 16, "out": tmp_path / "d", "env_options": SHORT}
    with pytest.raises(error, match=says) as told:
        collect(f"{module}:ending", workers=2, **given)
    kept = len(read_demonstrations(tmp_path / "d", worlds()))
    assert 1 <= kept <= 15
    if error is PolicyFailed:
        assert kept >= 12
        assert "in act" in "".join(told.value.__notes__)
    tired.unlink()
    assert collect(f"{module}:ending", **given).resumed == kept
    collect("random", episodes=16, out=tmp_path / "whole", env_options=SHORT)
    assert len(read_demonstrations(tmp_path / "d", worlds())) == 16


@pytest.mark.parametrize("workers", [0, 10**6])
def test_numbers_of_workers_that_are_mistakes_are_refused(workers, tmp_path):
    with pytest.raises(ConfigurationError, match=r"workers must be at least 1 and at most 1,000"):
        collect("random", episodes=1, out=tmp_path / "d", workers=workers)
    assert not (tmp_path / "d").exists()
