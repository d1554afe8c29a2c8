"""Agents on a model hub, such as Hugging Face's: uploaded with a model card, and downloaded with all checks.

An agent is a graph and a card, which carry no code. So a stranger's can be pulled and run.
"""

from armctl.integrations.hub.download import pull
from armctl.integrations.hub.model_card import comparison_command, model_card
from armctl.integrations.hub.upload import push

__all__ = ["comparison_command", "model_card", "pull", "push"]
