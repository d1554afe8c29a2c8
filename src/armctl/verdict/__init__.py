"""Summaries of episodes, tables of them, and the sentences of a verdict."""
