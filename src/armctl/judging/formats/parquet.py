"""Parquet files, which the extra `parquet` reads."""

from pathlib import Path

from armctl.core.errors import missing_extra
from armctl.judging.rows import Rows

NESTED = ("list", "map", "struct")


def read(path: Path) -> list[Rows]:
    """Read the plain columns of a Parquet file. Raises `ConfigurationError`, `OSError` or `ValueError`."""
    try:
        import pyarrow
        from pyarrow import parquet
    except ModuleNotFoundError as error:
        raise missing_extra(str(path), error, "parquet") from error
    try:
        names = [field.name for field in parquet.read_schema(path) if not str(field.type).startswith(NESTED)]
        table = parquet.read_table(path, columns=names)
    except pyarrow.ArrowException as error:
        raise ValueError(f"it is no Parquet file: {error}") from error
    columns = [table.column(name).to_pylist() for name in names]
    values = [list(row) for row in zip(*columns, strict=True)]
    return [Rows(source=str(path), headings=names, values=values, places=range(1, len(values) + 1), unit="row")]
