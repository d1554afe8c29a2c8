"""Foundations of all packages: errors, files, options, registration, seeds, the terminal."""
