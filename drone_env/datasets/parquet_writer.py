"""A data set as one Parquet file, written row group by row group."""

# pyarrow declares no types.
# pyright: reportUnknownVariableType=false, reportUnknownArgumentType=false, reportUnknownParameterType=false

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from drone_env.datasets.columns import Column, columns
from drone_env.datasets.config import DatasetConfig
from drone_env.datasets.trajectories import Trajectory
from drone_env.errors import MissingPackageError

if TYPE_CHECKING:
    import pyarrow

FILE = "steps.parquet"


class ParquetWriter:
    """Writes `steps.parquet` into a folder. Each call of `write` makes one row group.

    The schema's metadata holds the configuration as JSON under `drone_env`; each field's holds its meaning and shape.

    Raises:
        MissingPackageError: if pyarrow is not installed.
    """

    def __init__(self, folder: Path, config: DatasetConfig) -> None:
        try:
            import pyarrow
            import pyarrow.parquet
        except ImportError as error:
            raise MissingPackageError("pyarrow", "data") from error
        self._arrow = pyarrow
        self._columns = columns(config.task)
        fields = [self._field("episode", "int64", (), "number of the flight, from 0")]
        fields += [self._field(column.name, column.dtype, column.shape, column.text) for column in self._columns]
        self._schema = pyarrow.schema(fields, {"drone_env": json.dumps(config.as_json())})
        self._writer = pyarrow.parquet.ParquetWriter(folder / FILE, self._schema, compression="zstd")

    def write(self, first_episode: int, trajectories: Sequence[Trajectory]) -> None:
        """Append flights, numbered from `first_episode` on."""
        numbers = np.arange(first_episode, first_episode + len(trajectories))
        arrays = [self._arrow.array(np.repeat(numbers, [trajectory.steps for trajectory in trajectories]))]
        arrays += [self._array(column, trajectories) for column in self._columns]
        table = self._arrow.Table.from_arrays(arrays, schema=self._schema)
        self._writer.write_table(table, row_group_size=len(table))

    def close(self) -> None:
        """Complete the file."""
        self._writer.close()

    def _field(self, name: str, dtype: str, shape: tuple[int, ...], text: str) -> "pyarrow.Field[Any]":
        item = self._arrow.type_for_alias(dtype)
        size = int(np.prod(shape))
        of_item = self._arrow.field("element", item, nullable=False)
        kind = self._arrow.list_(of_item, size) if shape else item
        metadata = {"description": text, "shape": json.dumps(shape)}
        return self._arrow.field(name, kind, nullable=False, metadata=metadata)

    def _array(self, column: Column, trajectories: Sequence[Trajectory]) -> "pyarrow.Array[Any]":
        kind = self._schema.field(column.name).type
        parts: list[npt.NDArray[Any]] = []
        for trajectory in trajectories:
            part = column.values(trajectory)
            parts.append(np.full(trajectory.steps, part) if np.ndim(part) == 0 else part)
        values = np.concatenate(parts)
        if not column.shape:
            return self._arrow.array(values, kind)
        flat = self._arrow.array(values.reshape(-1), kind.value_type)
        return self._arrow.FixedSizeListArray.from_arrays(flat, type=kind)
