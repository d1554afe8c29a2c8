"""Statistics of episodes: intervals, paired tests, power, training seeds, tasks, robustness."""
