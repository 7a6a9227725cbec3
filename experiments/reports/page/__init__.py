"""A report as one self-contained page: what it shows, in which sections, and how none of it can run."""
