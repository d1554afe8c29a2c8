"""Potential-based reward shaping: what an expert knows of a state, as a reward that leaves the best policy as it is."""

from armctl.shaping.oracles import Oracle, OracleFactory, make_oracle, oracle_names
from armctl.shaping.wrappers import Shaped, ShapedEnv

__all__ = ["Oracle", "OracleFactory", "Shaped", "ShapedEnv", "make_oracle", "oracle_names"]
