"""Policies, which map observations to actions, classical or learned; and how they are found."""

from armctl.policies.find import GROUP, describe_policy, make_policy, named_policies, policy_name, policy_names
from armctl.policies.policy import Actions, Controller, PerWorld, Plans, Policy, PolicyFactory

__all__ = [
    "GROUP", "Actions", "Controller", "PerWorld", "Plans", "Policy", "PolicyFactory", "describe_policy", "make_policy",
    "named_policies", "policy_name", "policy_names",
]  # fmt: skip
