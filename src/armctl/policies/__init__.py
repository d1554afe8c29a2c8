"""Policies, which map observations to actions, classical or learned; and how they are found."""

from typing import TYPE_CHECKING

from armctl.core.lazy import on_first_use

if TYPE_CHECKING:
    from armctl.envs.sees import interfaces_in_words, isolation, privileges
    from armctl.policies.configuration import (
        SUFFIX,
        PolicyConfiguration,
        configurations,
        configured,
        is_code,
        read_configuration,
    )
    from armctl.policies.declare import interface, made_for, sees
    from armctl.policies.find import (
        make_policy,
        named_policies,
        policy_name,
    )
    from armctl.policies.names import (
        GROUP,
        UNSKILLED,
        agent_cards,
        check_policy_name,
        declared_sees,
        describe_policy,
        policy_names,
    )
    from armctl.policies.policy import Actions, Controller, ControllersFailed, PerWorld, Plans, Policy, PolicyFactory
    from armctl.policies.trainings import expanded, is_seed_group, learners, training_card
    from armctl.policies.worlds import WorldsByInterface

__all__ = [
    "GROUP", "SUFFIX", "UNSKILLED", "Actions", "Controller", "ControllersFailed", "PerWorld", "Plans", "Policy",
    "PolicyConfiguration", "PolicyFactory", "WorldsByInterface", "agent_cards", "check_policy_name",
    "configurations", "configured", "declared_sees", "describe_policy", "expanded", "interface", "interfaces_in_words",
    "is_code", "is_seed_group", "isolation", "learners", "made_for", "make_policy", "named_policies", "policy_name",
    "policy_names", "privileges", "read_configuration", "sees", "training_card",
]  # fmt: skip

__getattr__, __dir__ = on_first_use(__name__)
