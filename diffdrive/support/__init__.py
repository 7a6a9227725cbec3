"""What every part of the package leans on: files, messages, units, limits of this machine."""
