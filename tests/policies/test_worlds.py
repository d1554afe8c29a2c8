"""Policies with different interfaces in the same worlds."""

from contextlib import closing

import pytest

from armctl.core.errors import ConfigurationError
from armctl.policies import WorldsByInterface
from armctl.study import compare

BRIDGE = "armctl/BridgeCross-v0"


def test_a_policy_without_images_is_spared_lost_images():
    disturbed = {"disturbances": {"dropout": 0.5, "payload": 5.0}}
    with closing(WorldsByInterface(BRIDGE, 1, disturbed)) as worlds:
        assert set(worlds.requested.disturbances) == {"dropout", "payload"}
        assert set(worlds.of("bridge_state_ppo").disturbances) == {"payload"}
        assert set(worlds.of("bridge_ppo").disturbances) == {"dropout", "payload"}


@pytest.mark.slow
def test_lost_images_change_nothing_for_a_policy_without_images():
    plain, spared, blinded = (
        compare(names, BRIDGE, episodes=2, env_options={"max_episode_steps": 40} | options).results
        for names, options in (
            (["bridge_state_ppo", "bridge_ppo"], {}),
            (["bridge_state_ppo"], {"disturbances": {"dropout": 0.75}}),
            (["bridge_ppo"], {"disturbances": {"dropout": 0.75}}),
        )
    )
    by_policy = plain.by_policy()
    assert [one.total_reward for one in spared] == [one.total_reward for one in by_policy["bridge_state_ppo"]]
    assert [one.total_reward for one in blinded] != [one.total_reward for one in by_policy["bridge_ppo"]]


def test_what_is_unknown_in_the_asked_interface_is_refused():
    with pytest.raises(ConfigurationError, match="no disturbance here 'dropout'"):
        WorldsByInterface(BRIDGE, 1, {"disturbances": {"dropout": 0.5}, "observation": "state"})
