"""Recipes and learners, trainings with one seed or several, and the ledger of trials."""
