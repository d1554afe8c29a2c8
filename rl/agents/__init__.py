"""The trained agents that come with armctl: an ONNX graph and a JSON card each."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from armctl.agents import OnnxPolicy, load_agent
from armctl.envs.sees import Sees
from armctl.policies.declare import sees

AGENTS = Path(__file__).parent


def _agent(name: str, description: str, privilege: Sees = "observation") -> Callable[[Any], OnnxPolicy]:
    """Return the function that loads an agent for an environment or an interface."""

    def load(env: Any) -> OnnxPolicy:
        return load_agent(AGENTS / f"{name}.json", env)

    load.__name__ = load.__qualname__ = name
    load.__doc__ = description
    return sees(privilege)(load)


reach_ppo = _agent("reach_ppo", "PPO on `armctl/ArmReach-v0`, robot `ur5`, position control.")
reach_sac = _agent("reach_sac", "SAC with hindsight on `armctl/ArmReach-v0`, without reward shaping.")
reach_td_mpc2 = _agent("reach_td_mpc2", "TD-MPC2, small, on `armctl/ArmReach-v0`: plans in a learned world model.")
reach_bc = _agent("reach_bc", "Behaviour cloning on `armctl/ArmReach-v0`, from 500 episodes of `reach_ik`.")
reach_dagger = _agent("reach_dagger", "DAgger on `armctl/ArmReach-v0`, with 500 episodes labelled by `reach_ik`.")
reach_cloned_ppo = _agent("reach_cloned_ppo", "A clone of `reach_ik` on `armctl/ArmReach-v0`, improved by PPO.")
reach_robust_ppo = _agent(
    "reach_robust_ppo", "PPO on `armctl/ArmReach-v0`, each of whose training episodes was disturbed."
)
moving_ppo = _agent("moving_ppo", "A clone of `reach_ik` on `armctl/ArmReachMoving-v0`, from which PPO goes on.")
moving_dagger = _agent("moving_dagger", "DAgger on `armctl/ArmReachMoving-v0`, from `reach_ik`.")
moving_robust_distil = _agent(
    "moving_robust_distil",
    "`moving_dagger`, distilled in training episodes that were disturbed; it knows the arm's kinematics.",
    "model",
)
obstacles_robust_distil = _agent(
    "obstacles_robust_distil",
    "`obstacles_plan_bc` in training episodes with sensor noise; it sees the boxes, and knows the arm's geometry.",
    "model",
)
obstacles_plan_bc = _agent(
    "obstacles_plan_bc",
    "Clone of plans on `armctl/ArmReachObstacles-v0`; it sees the boxes, and knows where the arm's links are.",
    "model",
)
lift_bc = _agent("lift_bc", "Behaviour cloning on `armctl/ArmLift-v0`, from `lift_grasp` without its memory.")
pose_dagger = _agent("pose_dagger", "DAgger on `armctl/ArmPose-v0`, in imagination, labelled by inverse kinematics.")
push_act = _agent(
    "push_act", "Chunks of a small transformer on `armctl/ArmPush-v0`, from `push_line` without its memory."
)
push_cloned_ppo = _agent(
    "push_cloned_ppo", "A clone of `push_line` without its memory on `armctl/ArmPush-v0`, from which PPO goes on."
)
lift_cloned_ppo = _agent(
    "lift_cloned_ppo", "A clone of `lift_grasp` without its memory, improved by PPO on `armctl/ArmLift-v0`."
)
push_sac = _agent(
    "push_sac", "SAC with hindsight on `armctl/ArmPush-v0`, which imitates the first steps, `push_line`'s."
)
push_bc = _agent("push_bc", "Behaviour cloning on `armctl/ArmPush-v0`, from `push_line` without its memory.")
push_flow = _agent("push_flow", "Flow matching of chunks on `armctl/ArmPush-v0`, from `push_line` without its memory.")
scenes_plan_bc = _agent(
    "scenes_plan_bc",
    "Clone of plans on `armctl/ArmScenes-v0`; it sees the boxes, and knows where the arm's links are.",
    "model",
)
obstacles_ppo = _agent(
    "obstacles_ppo",
    "`obstacles_plan_bc`, improved by PPO; it sees the boxes, and knows where the arm's links are.",
    "model",
)
bridge_state_ppo = _agent(
    "bridge_state_ppo", "PPO on `armctl/BridgeCross-v0`, without physics; it sees the true state.", "state"
)
bridge_robust_ppo = _agent(
    "bridge_robust_ppo",
    "PPO on `armctl/BridgeCross-v0`, in training episodes that were disturbed; it sees the true state.",
    "state",
)
bridge_moving_state_ppo = _agent(
    "bridge_moving_state_ppo", "PPO on `armctl/BridgeCrossMoving-v0`, without physics; it sees the true state.", "state"
)
barn_moving_state_ppo = _agent(
    "barn_moving_state_ppo", "PPO on `armctl/BarnCrossMoving-v0`, without physics; it sees the true state.", "state"
)
barn_route_ppo = _agent(
    "barn_route_ppo",
    "PPO on `armctl/BarnCross-v0`, without physics; it sees the true state, and computes the shortest ways from it.",
    "state",
)
barn_ppo = _agent(
    "barn_ppo",
    "`bridge_distil`, improved by PPO on `armctl/BarnCross-v0`; it sees the depth camera and its own motion.",
)
bridge_distil = _agent(
    "bridge_distil",
    "`bridge_state_ppo`, distilled into a network with a memory; it sees the depth camera and its own motion.",
)
bridge_robust_distil = _agent(
    "bridge_robust_distil",
    "`bridge_distil` in training episodes that were disturbed; it sees the depth camera and its own motion.",
)
bridge_moving_distil = _agent(
    "bridge_moving_distil",
    "`bridge_moving_state_ppo`, distilled into a network with a memory; it sees the depth camera and its motion.",
)
bridge_moving_robust_distil = _agent(
    "bridge_moving_robust_distil",
    "`bridge_moving_distil` in training episodes that were disturbed; it sees the depth camera and its motion.",
)
bridge_ppo = _agent("bridge_ppo", "`bridge_distil`, improved by PPO; it sees the depth camera and its own motion.")
bridge_moving_ppo = _agent(
    "bridge_moving_ppo",
    "PPO on `armctl/BridgeCrossMoving-v0`, from `bridge_moving_distil`; it sees the depth camera and its motion.",
)
