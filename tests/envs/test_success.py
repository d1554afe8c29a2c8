"""Success of an episode, read from infos and returns by each rule."""

from typing import Any

import numpy as np
import pytest

from armctl.core.errors import ConfigurationError
from armctl.envs.success import SuccessReader, SuccessRule
from armctl.study import compare
from armctl.study.results import read_comparison

YES, NO, SILENT = {"success": True}, {"success": False}, {"other": 1}
EPISODES: dict[str, list[dict[str, Any]]] = {
    "never": [NO, NO], "early": [YES, NO], "late": [NO, YES], "early, then silent": [YES, SILENT],
    "refused, then silent": [NO, SILENT], "silent": [SILENT, SILENT],
}  # fmt: skip


def outcomes(**options):
    remarks = {}
    reader = SuccessReader(SuccessRule(**options), 1, "Some-v0", remarks)
    told = {}
    for name, infos in EPISODES.items():
        reader.begin(np.zeros(1, np.int32))
        for reward, info in enumerate(infos):
            reader.step(0, float(reward), info)
        told[name] = reader.success(0, infos[-1])
    return [*told.values()], " ".join(remarks)


def test_success_of_the_last_step_of_any_step_and_by_return():
    assert outcomes()[0] == outcomes(success="last")[0] == [False, False, True, None, None, None]
    assert outcomes(success="any")[0] == [False, True, True, True, False, None]
    assert outcomes(success_return=1.0)[0] == outcomes(success="return", success_return=1)[0] == [True] * 6
    assert outcomes(success_return=1.1)[0] == [False] * 6


def test_an_early_success_is_remarked_unless_the_rule_is_stated():
    assert "With --success any, each step does" in outcomes()[1]
    assert outcomes(success="last")[1] == outcomes(success="any")[1] == ""


def test_another_key_and_one_that_is_misspelt():
    assert outcomes(success_key="other")[0] == [None] * 3 + [True] * 3
    told, remarks = outcomes(success_key="sucess")
    assert told == [None] * 6
    assert 'without info["sucess"]' in remarks
    assert "Did you mean 'success'?" in remarks


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"success": "eny"}, "Did you mean 'any'"),
        ({"success": "return"}, "needs the least return"),
        ({"success": "any", "success_return": 3.0}, "leave one out"),
        ({"success_key": "solved", "success_return": 3.0}, "leave one out"),
        ({"success_return": "much"}, "is a number"),
        ({"success_return": float("nan")}, "is a number"),
        ({"success_key": 3}, "is a key of info"),
    ],
)
def test_options_that_are_no_rule_are_refused(options, says):
    with pytest.raises(ConfigurationError, match=says):
        SuccessRule(**options)


def test_the_rule_is_stated_in_the_results_and_no_other_one_resumes_them(tmp_path):
    arguments = {"env": "Pendulum-v1", "episodes": 1, "out": tmp_path}
    options = {"max_episode_steps": 2}
    compare("random", **arguments, env_options={**options, "success_return": -30})
    assert "An episode is a success if its return is at least -30." in read_comparison(tmp_path).notes
    for other in ({}, {"success_return": -20}, {"success": "any"}):
        with pytest.raises(Exception, match="another comparison"):
            compare("random", **arguments, env_options=options | other)
