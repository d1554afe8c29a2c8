"""Policies and environments in other processes, of any Python: the protocol, its two ends, and how they are named."""
