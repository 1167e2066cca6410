"""The columns of a study's results, one at a time, so that few of them are in memory."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopqp.checked import Array
from coopqp.errors import CoopqpError
from coopqp.study.sweep.results import NAME


@dataclass(frozen=True)
class Columns:
    """Results on disk.

    Attributes:
        path: of the Parquet file.
    """

    path: Path

    @classmethod
    def of(cls, folder: Path) -> Columns:
        """Those in the folder of a study.

        Raises:
            CoopqpError: there are none.
        """
        if not (folder / NAME).is_file():
            raise CoopqpError(f"'{folder}' has no {NAME} yet")
        return cls(folder / NAME)

    @cached_property
    def kinds(self) -> Mapping[str, str]:
        """By name, what is in a column: "bool", "int64", "double" or "string"."""
        from pyarrow import parquet as pq

        return {field.name: str(field.type) for field in pq.read_schema(self.path)}

    def __len__(self) -> int:
        from pyarrow import parquet as pq

        return int(pq.read_metadata(self.path).num_rows)

    def _column(self, name: str) -> Any:
        from pyarrow import parquet as pq

        return pq.read_table(self.path, columns=[name]).column(0).combine_chunks()

    def numbers(self, name: str) -> Array:
        """A column of numbers or truths, shape (rows,); NaN where there is none.

        What only rows that are done have is no column before one is.
        """
        if name not in self.kinds:
            return np.full(len(self), np.nan)
        import pyarrow as pa

        column = self._column(name).cast(pa.float64())
        found: Array = column.to_numpy(zero_copy_only=False)
        return found

    def codes(self, name: str) -> tuple[NDArray[np.int64], list[str]]:
        """A column of texts: the number of each row's text, -1 for none, and the texts."""
        column = self._column(name).dictionary_encode()
        codes = column.indices.fill_null(-1).to_numpy(zero_copy_only=False)
        return codes.astype(np.int64), [str(text) for text in column.dictionary.to_pylist()]
