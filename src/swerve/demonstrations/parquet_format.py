"""Read Parquet with polars, which is imported when a file is read."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from swerve.demonstrations.tables import Table, select_columns


def read_parquet(
    path: Path, required: Sequence[str], optional: Sequence[str], label: str | None
) -> Table:
    """Read columns of a Parquet file; see `formats.read_table`."""
    import polars as pl  # takes longer to load than all other modules together

    try:
        schema = pl.read_parquet_schema(path)
        names = select_columns(path, list(schema), required, optional, label)
        frame = pl.read_parquet(path, columns=names if label is None else [label, *names])
    except pl.exceptions.PolarsError as error:
        raise ValueError(f"{path}: cannot be read as Parquet: {error}") from error
    for name in names:
        if not schema[name].is_numeric():
            raise ValueError(f"{path}: column {name}: expected numbers, got {schema[name]} values")
        if name in required and frame[name].null_count():
            row = frame[name].is_null().arg_true()[0]
            raise ValueError(f"{path}: row {row + 1}, column {name}: expected a number, got null")
    numbers = frame.select(pl.col(names).cast(pl.Float64).fill_null(float("nan")))
    labels = [] if label is None else frame[label].cast(pl.String).to_list()
    return Table(names, numbers.to_numpy(), labels, None)
