"""Episodes of others whose observations, names and pictures are unusual are printed and logged as they are."""

import pytest

from ..command_line import armctl

HOSTILE = """
import gymnasium, numpy as np
S = gymnasium.spaces

class Odd(gymnasium.Env):
    action_space = S.Box(-1, 1, (1,))
    observation_space = S.Dict({
        "[/]\\x1b": S.Box(-1, 1, (2,)), "../../x": S.Text(5), "empty": S.Box(0, 255, (0, 4, 3), np.uint8),
        "both": S.Tuple((S.Discrete(3), S.Box(-np.inf, np.inf, (1,)))),
        "deep": S.Dict({"er": S.Tuple((S.Text(3), S.Dict({"est": S.MultiBinary(2)})))}),
    })

    def observed(self):
        return {
            "[/]\\x1b": np.full(2, np.nan, np.float32), "../../x": "ab", "empty": np.zeros((0, 4, 3), np.uint8),
            "both": (np.int64(1), np.array([np.inf], np.float32)),
            "deep": {"er": ("cd", {"est": np.zeros(2, np.int8)})},
        }

    def reset(self, seed=None, options=None):
        self.steps = 0
        return self.observed(), {}

    def step(self, action):
        self.steps += 1
        return self.observed(), 0.0, self.steps == 3, False, {"[red]\\x1b": np.nan, "reward_terms": {"../x": 1.0}}

class Alone(Odd):
    observation_space = Odd.observation_space["both"]

    def observed(self):
        return super().observed()["both"]

def zero(observation):
    return [0.0]
"""


@pytest.mark.parametrize("env", ["Odd", "Alone"])
@pytest.mark.parametrize("log", [(), ("--rerun", "log.rrd")])
def test_unusual_observations_are_shown(env, log, tmp_path):
    (tmp_path / "hostile.py").write_text(HOSTILE)
    done = armctl("run", "hostile.py:zero", "--env", f"hostile.py:{env}", *log, cwd=tmp_path)
    assert "terminated after 3 steps" in done.stdout
    assert "inf" in done.stdout
    assert "\x1b" not in done.stdout
    assert env == "Alone" or "deep/er/1/est" in done.stdout
    assert (tmp_path / "log.rrd").exists() == bool(log)
    assert sorted(path.name for path in tmp_path.iterdir() if path.suffix != ".rrd" and path.name != "__pycache__") == [
        "hostile.py"
    ]
