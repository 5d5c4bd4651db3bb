"""A topic's CSV as Parquet, by pyarrow, which is not installed with the rest."""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping
from pathlib import Path

from valor.bags.errors import BagError

BLOCK = 8 << 20  # of CSV that is read at once [B]


def require() -> None:
    """See that it can be written.

    Raises:
        BagError: says what to install.
    """
    if importlib.util.find_spec("pyarrow") is None:
        raise BagError("Parquet needs pyarrow, which is not installed: pip install 'valor[parquet]'")


def convert(file: Path, types: Mapping[str, type]) -> Path:
    """Put a Parquet file in a CSV's place; returns its path.

    Args:
        file: the CSV; removed.
        types: bool, int, float or str of every column. What a row does not have is null, and so is empty text.

    Raises:
        BagError: a value is not of its column's type.
    """
    import pyarrow
    from pyarrow import csv, parquet

    known = {bool: pyarrow.bool_(), int: pyarrow.int64(), float: pyarrow.float64(), str: pyarrow.string()}
    schema = pyarrow.schema([(name, known[kind]) for name, kind in types.items()])
    target = file.with_suffix(".parquet")
    try:
        with (
            csv.open_csv(
                file,
                read_options=csv.ReadOptions(block_size=BLOCK),
                parse_options=csv.ParseOptions(newlines_in_values=True),
                convert_options=csv.ConvertOptions(column_types=schema, null_values=[""], strings_can_be_null=True),
            ) as rows,
            parquet.ParquetWriter(target, schema, compression="zstd") as writer,
        ):
            for batch in rows:
                writer.write_batch(batch)
    except pyarrow.ArrowInvalid as error:
        target.unlink(missing_ok=True)
        raise BagError(f"{file}: not writable as Parquet, left as it is: {' '.join(str(error).split())}") from None
    file.unlink()
    return target
