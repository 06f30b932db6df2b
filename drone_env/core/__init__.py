"""The rules of the world, once."""

# First, because it hashes the sources that the process loads.
import drone_env.core.compile_cache as _compile_cache  # noqa: F401  # pyright: ignore[reportUnusedImport]
