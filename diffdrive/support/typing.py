"""Types that several packages share."""

TomlTable = dict[str, object]  # a table of a drive file, as a TOML reader gives it
