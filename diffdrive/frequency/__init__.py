"""Measured frequency responses: what they are of, their files, the resonances in them."""
