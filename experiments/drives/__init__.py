"""The drive files that come with the package."""

from pathlib import Path

PAPER_DRIVE = Path(__file__).with_name("paper.toml")
