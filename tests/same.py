"""Equality to the last bit."""

from typing import Any


def assert_same(got: Any, want: Any) -> None:
    """Equal values; arrays and tensors of the same type and shape; the same in dictionaries and lists."""
    if isinstance(want, dict):
        assert got.keys() == want.keys()
        for name, part in want.items():
            assert_same(got[name], part)
    elif isinstance(want, (list, tuple)):
        assert len(got) == len(want)
        for pair in zip(got, want, strict=True):
            assert_same(*pair)
    elif hasattr(want, "dtype"):
        assert (got.dtype, got.shape) == (want.dtype, want.shape)
        assert (got == want).all()
    else:
        assert got == want or (got != got and want != want)  # NaN is equal to NaN here
