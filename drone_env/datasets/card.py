"""The page that lies beside a data set and says what it holds."""

import json

from drone_env.datasets.columns import columns
from drone_env.datasets.config import DatasetConfig
from drone_env.datasets.minari_writer import FOLDER, dataset_id
from drone_env.datasets.parquet_writer import FILE
from drone_env.errors import needs


def card(config: DatasetConfig, formats: tuple[str, ...], rows: int) -> str:
    """The page, as Markdown with the front matter that data set hubs read.

    Raises:
        MissingPackageError: if the extra `data` is not installed.
    """
    with needs("data"):
        from drone_env.reports.pages import render

    return render(
        "dataset.md",
        config=config,
        task=config.task,
        columns=columns(config.task),
        formats=formats,
        rows=rows,
        parquet=FILE,
        minari=FOLDER,
        dataset_id=dataset_id(config),
        about=json.dumps(config.as_json(), indent=2),
    )
