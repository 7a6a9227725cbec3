"""Which motion would tell what the logs leave open."""
