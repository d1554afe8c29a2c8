"""Potential-based reward shaping: what an expert knows of a state, as a reward that leaves the best policy as it is."""

from armctl.shaping.potentials import PotentialFactory, make_potential, potential_names
from armctl.shaping.wrappers import Shaped, ShapedEnv
from armctl.tasks import Potential

__all__ = ["Potential", "PotentialFactory", "Shaped", "ShapedEnv", "make_potential", "potential_names"]
