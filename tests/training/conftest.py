"""No training plays the sealed test."""

from ..sealing import sealed  # noqa: F401 - a fixture
