"""Potential-based reward shaping: experts' knowledge as a reward term that leaves the optimal policy unchanged."""

from armctl.shaping.potentials import PotentialFactory, make_potential, potential_names
from armctl.shaping.wrappers import Shaped, ShapedEnv
from armctl.tasks import Potential

__all__ = ["Potential", "PotentialFactory", "Shaped", "ShapedEnv", "make_potential", "potential_names"]
