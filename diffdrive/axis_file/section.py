"""One table of a drive file: keys are taken out one by one, numbers in any unit, and what is left over is an error."""

import dataclasses
import difflib
from collections.abc import Callable

from diffdrive.controllers.kinds import Parameters
from diffdrive.errors import DriveFileError, ParameterError
from diffdrive.model.data_sheet import NO_SHEET, DataSheet
from diffdrive.model.motor_units import axis_unit, to_axis_si
from diffdrive.model.quantity import Directional, Quantity, check
from diffdrive.support.messages import short_repr, shortened
from diffdrive.support.units import in_unit


class TomlSection:
    """One table of a drive file; takes keys out one by one and raises for those that are left."""

    def __init__(self, source: str, name: str, table: object, sheet: DataSheet = NO_SHEET) -> None:
        if not isinstance(table, dict):
            raise DriveFileError(f"{source}: [{name}] must be a table, got {short_repr(table)}")
        self.source, self.name, self.table, self._remaining = source, name, table, dict(table)
        self.sheet = sheet  # by which units of the motor are read
        self._accepted: list[str] = []
        self._below: list[TomlSection] = []
        self.kind: str | None = None  # of the controller, where the accepted keys depend on it
        self.kinds_with: Callable[[str], list[str]] = lambda key: []  # the other kinds that accept a key

    def fail(self, key: str, problem: str) -> DriveFileError:
        """The error for a bad `key`."""
        return DriveFileError(f"{self.source}: [{self.name}] {shortened(key)}: {problem}")

    def take(self, key: str, default: object = dataclasses.MISSING) -> object:
        """The raw value of `key`, or the default."""
        self._accepted.append(key)
        if key not in self._remaining:
            if default is dataclasses.MISSING:
                raise self.fail(key, "is missing")
            return default
        return self._remaining.pop(key)

    def subsection(self, key: str) -> "TomlSection":
        """The table below `key`, empty if it is absent."""
        subsection = TomlSection(self.source, f"{self.name}.{key}", self.take(key, {}), self.sheet)
        if self.kind is not None:
            subsection.set_kind(self.kind, self._kinds_of_table)
        self._below.append(subsection)
        return subsection

    def subsections(self, key: str) -> "list[TomlSection]":
        """The tables of the array of tables below `key`, none if it is absent."""
        tables = self.take(key, [])
        if not isinstance(tables, list):
            raise self.fail(key, f"must be an array of tables, [[{self.name}.{key}]], got {short_repr(tables)}")
        return [TomlSection(self.source, f"{self.name}.{key}.{k}", table) for k, table in enumerate(tables, 1)]

    def set_kind(self, kind: str, kinds_with: Callable[[str, str], list[str]]) -> None:
        """Set the controller's kind, and the function from table and key to the kinds that accept it."""
        self.kind, self._kinds_of_table = kind, kinds_with
        self.kinds_with = lambda key: kinds_with(self.name, key)

    def number(self, key: str, unit: str, default: object = dataclasses.MISSING) -> float:
        """A number in SI, converted from a string with a unit where one is given."""
        return self.number_from(key, self.take(key, default), unit)

    def number_from(self, key: str, value: object, unit: str) -> float:
        """The number that a value of `key` is, in SI; raises `DriveFileError` for what is none."""
        if isinstance(value, bool) or not isinstance(value, int | float | str):
            own = axis_unit(unit, self.sheet)
            or_text = "" if unit == "1" else f', or a string such as "1.5 {own}"'
            raise self.fail(key, f"must be a number{in_unit(own)}{or_text}, got {short_repr(value)}")
        if not isinstance(value, str):
            try:
                return float(value)
            except OverflowError:
                raise self.fail(key, f"{short_repr(value)} is larger than any number of double precision") from None
        try:
            return to_axis_si(value, unit, self.sheet)
        except ValueError as problem:
            raise self.fail(key, str(problem)) from None

    def quantity(self, key: str, declared: Quantity, default: object) -> object:
        """The value of one declared parameter: a number, or a pair where it may differ by direction."""
        if default is dataclasses.MISSING and key not in self._remaining:
            close = difflib.get_close_matches(key, self._remaining, n=1)
            hint = f"; is it meant by '{close[0]}'?" if close else ""
            unit = in_unit(axis_unit(declared.unit, self.sheet)) or " a number"
            raise self.fail(key, f"is missing: give the {declared.meaning},{unit}{hint}")
        value = self.take(key, default)
        if value is default:
            return value
        if value == "none" and declared.optional:
            return None
        if isinstance(value, list):
            if not declared.directional:
                unit = in_unit(axis_unit(declared.unit, self.sheet))
                raise self.fail(key, f"must be one number{unit}, got {short_repr(value)}")
            if len(value) != 2:
                raise self.fail(key, f"needs two values, [positive, negative], got {short_repr(value)}")
            return Directional(*(self.number_from(key, side, declared.unit) for side in value))
        return self.number_from(key, value, declared.unit)

    def build(self, cls: type[Parameters], **values: object) -> Parameters:
        """An instance of a parameter class from the keys of this section, beside `values`."""
        for field in dataclasses.fields(cls):
            if "quantity" in field.metadata and field.name not in values:
                values[field.name] = self.quantity(field.name, field.metadata["quantity"], field.default)
        try:
            built = cls(**values)
            check(built, self.name)
        except ParameterError as error:
            raise DriveFileError(f"{self.source}: {error}") from None
        return built

    def done(self) -> None:
        """Raise if keys are left that were never taken, here or in a subsection."""
        for subsection in self._below:
            subsection.done()
        if not self._remaining:
            return
        key = next(iter(self._remaining))
        if kinds := self.kinds_with(key):
            foreign = [other for other in self._remaining if self.kinds_with(other)]
            raise self.fail(
                key, f"belongs to kind {', '.join(kinds)}; for kind {self.kind} remove {', '.join(foreign)}"
            )
        close = difflib.get_close_matches(key, self._accepted, n=1)
        hint = f"did you mean '{close[0]}'?" if close else f"known here: {', '.join(sorted(set(self._accepted)))}"
        raise self.fail(key, f"unknown key; {hint}")
