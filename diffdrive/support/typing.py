"""Types that several packages share."""

import dataclasses
from typing import Any, ClassVar, Protocol

TomlTable = dict[str, object]  # a table of a drive file, as a TOML reader gives it


class DataclassInstance(Protocol):
    """Any instance of a dataclass, such as a module of parameters."""

    __dataclass_fields__: ClassVar[dict[str, dataclasses.Field[Any]]]
