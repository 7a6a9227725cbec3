"""The page itself: what needs the framework stands here, and is imported only by `diffdrive app`."""
