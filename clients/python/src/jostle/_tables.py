"""Tables of results, series, orders and trajectories."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from ._checksums import ParquetChecksums, reading
from ._extras import import_extra

if TYPE_CHECKING:
    import pandas


def read_table(path: str | os.PathLike[str]) -> pandas.DataFrame:
    """Reads a Parquet file of an experiment, as `pandas.read_parquet`, and checks all its bytes.

        runs = jostle.read_table("results/results.parquet")
        print(runs.groupby("n")["v"].mean())

    pandas, polars and DuckDB do not compare the checksums: they can read a damaged file as other
    values. Files of earlier versions and of other programs have none, and are not checked.

    Args:
        path: The file: results, series, orders, a trajectory or a recording.

    Raises:
        ImportError: pandas, pyarrow or blake3 is missing: `pip install jostle[recording]`.
        InvalidArgument: The file is no Parquet file, cut short or damaged; the message names it.
        OSError: It cannot be read.
    """
    reader = import_extra("pandas", "recording")
    parquet = import_extra("pyarrow.parquet", "recording")
    path = Path(path)
    with path.open("rb") as file, reading(path, "table"):
        ParquetChecksums(file, "recording").check_all()
        file.seek(0)
        parts = parquet.ParquetFile(file)
        names = parts.schema_arrow.names
        if len(set(names)) == len(names):
            file.seek(0)
            table: pandas.DataFrame = reader.read_parquet(file, engine="pyarrow")
            return table
        # Earlier versions accepted a variable named fault, before the column of the faults.
        names[names.index("fault")] = "fault_"
        renamed: pandas.DataFrame = parts.read().rename_columns(names).to_pandas()
        return renamed
