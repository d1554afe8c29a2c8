"""Rows as files have them: values under headings, each with its place."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NoReturn

from armctl.core.errors import ConfigurationError


@dataclass(kw_only=True)
class Rows:
    """Rows of one file, or of a part of it."""

    source: str
    """The file, as messages name it."""
    headings: Sequence[str]
    values: Sequence[Sequence[Any]]
    """Cells of each row: texts, or the numbers and truth values of a file that has types. None: nothing is there."""
    places: Sequence[int]
    """Number of each row, such as its line."""
    unit: str = "line"
    """Unit that these numbers count."""
    constants: Mapping[str, Any] = field(default_factory=dict)
    """Fields that are the same in all rows, by their name in `armctl.judging.columns.FIELDS`."""
    is_known_format: bool = False
    """True if the format is known, so that headings are names of fields, and others are of no interest."""
    delimiter: str = ","
    """Separator of the cells of a text file; where it is no comma, a comma may be a decimal sign."""
    notes: Sequence[str] = ()
    """Assumptions of the reader, as sentences."""
    time_limit: int | None = None
    """Largest number of steps of an episode, if the file says so."""
    setup: Mapping[str, str] = field(default_factory=dict)
    """Values that have to be equal in all files of a task and condition, by name, in words."""
    any_number: bool = False
    """True if it is a log, which may be judged after any trial."""
    return_bounds: tuple[float, float] | None = None
    """Possible returns, if the file says so."""

    def refuse(self, row: int, why: str) -> NoReturn:
        """Raise `ConfigurationError` for a row."""
        raise ConfigurationError(f"{self.source}, {self.unit} {self.places[row]}: {why}")


def rows_of_records(source: str, records: Sequence[Any], unit: str, **about: Any) -> Rows:
    """Return rows of mappings, whose keys become headings in the order in which they occur.

    Raises `ConfigurationError` for a record that is none.
    """
    for place, record in enumerate(records, 1):
        if not isinstance(record, Mapping):
            raise ConfigurationError(f"{source}, {unit} {place}: it is {record!r:.60}, not an object of named values")
    headings = list(dict.fromkeys(str(key) for record in records for key in record))
    values = [[record.get(name) for name in headings] for record in records]
    return Rows(source=source, headings=headings, values=values, places=range(1, len(values) + 1), unit=unit, **about)
