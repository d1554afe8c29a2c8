"""The environments that come with armctl."""

from armctl.core.registration import register

register("armctl/ArmLift-v0", "armctl.tasks:LiftTask", max_episode_steps=200)
register("armctl/ArmPose-v0", "armctl.tasks:ReachPoseTask", max_episode_steps=150)
register("armctl/ArmPush-v0", "armctl.tasks:PushTask", max_episode_steps=300)
register("armctl/ArmReach-v0", "armctl.tasks:ReachTask", max_episode_steps=100)
register("armctl/ArmReachMoving-v0", "armctl.tasks:ReachMovingTask", max_episode_steps=300)
register("armctl/ArmReachObstacles-v0", "armctl.tasks:ReachObstaclesTask", max_episode_steps=200)
register("armctl/ArmScenes-v0", "armctl.tasks:ReachScenesTask", max_episode_steps=200)
register("armctl/BarnCross-v0", "armctl.tasks:BarnTask", max_episode_steps=400)
register("armctl/BarnCrossMoving-v0", "armctl.tasks:BarnMovingTask", max_episode_steps=600)
register("armctl/BridgeCross-v0", "armctl.tasks:BridgeTask", max_episode_steps=300)
register("armctl/BridgeCrossMoving-v0", "armctl.tasks:BridgeMovingTask", max_episode_steps=600)
