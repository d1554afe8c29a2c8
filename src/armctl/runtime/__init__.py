"""Where episodes are played, and by what code: workers, clusters, versions, checksums of what ran."""
