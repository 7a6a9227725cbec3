"""A drive file from nothing but a trace: what can be guessed of it, what has to be asked."""
