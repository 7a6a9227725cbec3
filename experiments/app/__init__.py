"""`diffdrive app`: the commands on a local page. What it knows is on the disk, in one folder."""
