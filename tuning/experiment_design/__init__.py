"""Which motion would determine what the logs leave open."""
