"""A data set as one Parquet file, written row group by row group."""

# pyarrow declares no types.
# pyright: reportUnknownVariableType=false, reportUnknownArgumentType=false, reportUnknownMemberType=false

import json
import math
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from drone_env.datasets.columns import Column, columns
from drone_env.datasets.config import DatasetConfig
from drone_env.datasets.trajectories import Trajectory, Write
from drone_env.errors import needs

FILE = "steps.parquet"


@contextmanager
def parquet_writer(folder: Path, config: DatasetConfig) -> Generator[Write, None, None]:
    """Writes `steps.parquet` into a folder; it is complete at the end of the `with`. Each call makes one row group.

    The schema's metadata holds the configuration as JSON under `drone_env`; each field's holds its meaning and shape.

    Raises:
        MissingPackageError: if pyarrow is not installed.
    """
    with needs("data"):
        import pyarrow
        import pyarrow.parquet

    def field(column: Column) -> Any:
        item = pyarrow.type_for_alias(column.dtype)
        element = pyarrow.field("element", item, nullable=False)
        kind = pyarrow.list_(element, math.prod(column.shape)) if column.shape else item
        metadata = {"description": column.text, "shape": json.dumps(column.shape)}
        return pyarrow.field(column.name, kind, nullable=False, metadata=metadata)

    def array(column: Column, trajectories: Sequence[Trajectory]) -> Any:
        kind = schema.field(column.name).type
        parts = [(trajectory.steps, column.values(trajectory)) for trajectory in trajectories]
        values = np.concatenate([np.full(steps, part) if np.ndim(part) == 0 else part for steps, part in parts])
        if not column.shape:
            return pyarrow.array(values, kind)
        return pyarrow.FixedSizeListArray.from_arrays(pyarrow.array(values.reshape(-1), kind.value_type), type=kind)

    def write(trajectories: Sequence[Trajectory]) -> None:
        table = pyarrow.Table.from_arrays([array(column, trajectories) for column in described], schema=schema)
        file.write_table(table, row_group_size=len(table))

    described = columns(config.task)
    schema = pyarrow.schema(map(field, described), {"drone_env": json.dumps(config.as_json())})
    with pyarrow.parquet.ParquetWriter(folder / FILE, schema, compression="zstd") as file:
        yield write
