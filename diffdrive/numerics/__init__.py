"""Functions of the control step that are written out so that they fuse and stay exact."""
