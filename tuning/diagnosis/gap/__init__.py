"""The force that a drive lacks along its logs: how large, where, and on what it depends."""
