"""Episodes as datasets, in a standard format."""
