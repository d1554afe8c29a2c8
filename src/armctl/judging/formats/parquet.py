"""Parquet files, which the extra `parquet` reads."""

from pathlib import Path

from armctl.core.errors import missing_extra
from armctl.judging.rows import Rows

NESTED = ("list", "map", "struct")
MAX_ROWS, LARGEST = 5_000_000, 2**30
"""Rows, and bytes of all columns when they are unpacked: a small file may hold very large ones."""


def read(path: Path) -> list[Rows]:
    """Read the plain columns of a Parquet file. Raises `ConfigurationError`, `OSError` or `ValueError`."""
    try:
        import pyarrow
        from pyarrow import parquet
    except ModuleNotFoundError as error:
        raise missing_extra(str(path), error, "parquet") from error
    try:
        about = parquet.read_metadata(path)
        size = sum(about.row_group(i).total_byte_size for i in range(about.num_row_groups))
        if about.num_rows > MAX_ROWS or size > LARGEST:
            raise ValueError(f"it has {about.num_rows:,} rows of {size:,} bytes, more than {MAX_ROWS:,} or {LARGEST:,}")
        names = [field.name for field in parquet.read_schema(path) if not str(field.type).startswith(NESTED)]
        table = parquet.read_table(path, columns=names)
    except pyarrow.ArrowException as error:
        raise ValueError(f"it is no Parquet file: {error}") from error
    columns = [table.column(name).to_pylist() for name in names]
    values = [list(row) for row in zip(*columns, strict=True)]
    return [Rows(source=str(path), headings=names, values=values, places=range(1, len(values) + 1), unit="row")]
