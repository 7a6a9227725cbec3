"""What was found of each log, before and after."""

from typing import Generic, NamedTuple, TypeVar

T = TypeVar("T")


class Sides(NamedTuple, Generic[T]):
    """What each side's logs show, one for each log that shows it, and why others do not."""

    before: tuple[T, ...]
    after: tuple[T, ...]
    notes: tuple[str, ...]

    @property
    def are_comparable(self) -> bool:
        """Whether some log of each side shows it."""
        return bool(self.before and self.after)
