"""Tables from files of each format."""
