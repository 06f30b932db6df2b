"""The rules of the world, once."""

# Before all others: it looks at the sources as they are when they are loaded.
import drone_env.core.compile_cache as _compile_cache  # noqa: F401  # pyright: ignore[reportUnusedImport]
