"""What the logs would have shown of effects that were not found, and what they could not tell apart."""
