"""A controller whose law is unknown: logs can be identified, but no loop can be simulated."""

from typing import NoReturn

from jaxtyping import PyTree

from diffdrive.controllers.base import Controller, Reference
from diffdrive.controllers.kinds import Kind
from diffdrive.errors import ParameterError
from diffdrive.numerics.arrays import Scalar
from diffdrive.support.typing import TomlTable


class UnknownController(Controller):
    """An axis's controller of which only the logged command is known."""

    @property
    def kind(self) -> str:
        return "unknown"

    @property
    def can_simulate(self) -> bool:
        return False

    def table(self) -> TomlTable:
        return {}

    def init(self, position: Scalar) -> NoReturn:
        raise ParameterError(
            "the drive file's controller is 'unknown': to simulate its loop, give [controller] a kind and its gains"
        )

    def step(self, state: PyTree, reference: Reference, position: Scalar, applied: Scalar, period: float) -> NoReturn:
        self.init(position)


KIND = Kind(
    "unknown", "for identification and diagnosis, from the logged command", lambda section, drive: UnknownController()
)
