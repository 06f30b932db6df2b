"""Datasets of flights with the exact values of every step: `build_dataset`. Needs the extra `data`."""

from drone_env.errors import needs

with needs("data"):
    import jinja2 as jinja2
    import pyarrow as pyarrow
