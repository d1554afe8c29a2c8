"""Policies, which map observations to actions, classical or learned; and how they are found."""

from armctl.policies.find import (
    GROUP,
    declared_sees,
    describe_policy,
    make_policy,
    named_policies,
    policy_name,
    policy_names,
)
from armctl.policies.policy import Actions, Controller, PerWorld, Plans, Policy, PolicyFactory
from armctl.policies.privilege import privileges, sees

__all__ = [
    "GROUP", "Actions", "Controller", "PerWorld", "Plans", "Policy", "PolicyFactory", "declared_sees",
    "describe_policy", "make_policy", "named_policies", "policy_name", "policy_names", "privileges", "sees",
]  # fmt: skip
