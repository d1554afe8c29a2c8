"""The trained agents that come with armctl: an ONNX graph and a JSON card each."""

from pathlib import Path

from armctl.agents import OnnxPolicy, load_agent
from armctl.envs import EpisodeVectorEnv, Interface, ModelInterface
from armctl.policies import sees

AGENTS = Path(__file__).parent


def reach_ppo(env: Interface) -> OnnxPolicy:
    """PPO on `armctl/ArmReach-v0`, robot `ur5`, position control."""
    return load_agent(AGENTS / "reach_ppo.json", env)


def bridge_ppo(env: Interface) -> OnnxPolicy:
    """`bridge_distil`, improved by PPO; it sees the depth camera and its own motion."""
    return load_agent(AGENTS / "bridge_ppo.json", env)


def reach_bc(env: Interface) -> OnnxPolicy:
    """Behaviour cloning on `armctl/ArmReach-v0`, from 500 episodes of `reach_ik`."""
    return load_agent(AGENTS / "reach_bc.json", env)


def reach_dagger(env: Interface) -> OnnxPolicy:
    """DAgger on `armctl/ArmReach-v0`, with 500 episodes labelled by `reach_ik`."""
    return load_agent(AGENTS / "reach_dagger.json", env)


def reach_sac(env: Interface) -> OnnxPolicy:
    """SAC with hindsight on `armctl/ArmReach-v0`, without reward shaping."""
    return load_agent(AGENTS / "reach_sac.json", env)


def reach_cloned_ppo(env: Interface) -> OnnxPolicy:
    """A clone of `reach_ik` on `armctl/ArmReach-v0`, improved by PPO."""
    return load_agent(AGENTS / "reach_cloned_ppo.json", env)


def reach_robust_ppo(env: Interface) -> OnnxPolicy:
    """PPO on `armctl/ArmReach-v0`, each of whose training episodes was disturbed."""
    return load_agent(AGENTS / "reach_robust_ppo.json", env)


def moving_ppo(env: Interface) -> OnnxPolicy:
    """A clone of `reach_ik` on `armctl/ArmReachMoving-v0`, from which PPO goes on."""
    return load_agent(AGENTS / "moving_ppo.json", env)


def moving_dagger(env: Interface) -> OnnxPolicy:
    """DAgger on `armctl/ArmReachMoving-v0`, from `reach_ik`."""
    return load_agent(AGENTS / "moving_dagger.json", env)


@sees("model")
def obstacles_plan_bc(env: ModelInterface) -> OnnxPolicy:
    """Clone of plans on `armctl/ArmReachObstacles-v0`; it sees the boxes, and knows where the arm's links are."""
    return load_agent(AGENTS / "obstacles_plan_bc.json", env)


@sees("state")
def bridge_state_ppo(env: EpisodeVectorEnv) -> OnnxPolicy:
    """PPO on `armctl/BridgeCross-v0`, without physics; it sees the true state."""
    return load_agent(AGENTS / "bridge_state_ppo.json", env)


@sees("state")
def bridge_robust_ppo(env: EpisodeVectorEnv) -> OnnxPolicy:
    """PPO on `armctl/BridgeCross-v0`, in training episodes that were disturbed; it sees the true state."""
    return load_agent(AGENTS / "bridge_robust_ppo.json", env)


@sees("state")
def bridge_moving_state_ppo(env: EpisodeVectorEnv) -> OnnxPolicy:
    """PPO on `armctl/BridgeCrossMoving-v0`, without physics; it sees the true state."""
    return load_agent(AGENTS / "bridge_moving_state_ppo.json", env)


def bridge_distil(env: Interface) -> OnnxPolicy:
    """`bridge_state_ppo`, distilled into a network with a memory; it sees the depth camera and its own motion."""
    return load_agent(AGENTS / "bridge_distil.json", env)


def bridge_moving_distil(env: Interface) -> OnnxPolicy:
    """`bridge_moving_state_ppo`, distilled into a network with a memory; it sees the depth camera and its motion."""
    return load_agent(AGENTS / "bridge_moving_distil.json", env)


def bridge_moving_ppo(env: Interface) -> OnnxPolicy:
    """PPO on `armctl/BridgeCrossMoving-v0`, from `bridge_moving_distil`; it sees the depth camera and its motion."""
    return load_agent(AGENTS / "bridge_moving_ppo.json", env)
