"""The filter that follows a log along a drive and its effects, and what it answers to small changes."""
