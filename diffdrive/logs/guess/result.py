"""What was guessed of a trace, how sure that is, and what has to be asked."""

from typing import Literal, NamedTuple

from diffdrive.support.messages import option_text

Certainty = Literal["stated", "sure", "likely"]


class Guess(NamedTuple):
    """One thing that was guessed: what, its value, how sure, and why."""

    what: str
    value: str
    certainty: Certainty
    why: str

    def __str__(self) -> str:
        return f"{self.what}: {self.value} ({self.certainty}: {self.why})"


class Question(NamedTuple):
    """What cannot be guessed: the argument that answers it, of a channel where it is one of a channel's, and why.

    `example` is an answer, one of the readings that are open.
    """

    argument: str  # of `tuning.start`: columns, units, lead, mass, ...
    channel: str
    why: str
    example: str

    @property
    def option(self) -> str:
        """What the command line takes in answer, with the example."""
        if self.argument in ("columns", "units"):
            return option_text(self.argument.removesuffix("s"), f"{self.channel}={self.example}")
        return option_text(self.argument.replace("_", "-"), self.example)

    @property
    def prompt(self) -> str:
        """What a terminal shows."""
        what = f"{self.argument.removesuffix('s')} of the {self.channel}" if self.channel else self.argument
        return f"{self.why[0].upper()}{self.why[1:]}.\n{what.replace('_', ' ')}, such as {self.example}"

    def __str__(self) -> str:
        return f"{self.why}: {self.option}"
