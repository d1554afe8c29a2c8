"""Episodes as datasets that others can read."""
