"""How accurate an axis is, in the terms of ISO 230, and what each unmodelled effect costs of that."""
