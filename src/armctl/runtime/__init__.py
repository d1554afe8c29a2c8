"""Execution of episodes, and provenance of their code: workers, clusters, versions, checksums of what ran."""
