"""Gains within requirements, verified on what they were not tuned on."""
