"""Arrays that somebody else wrote: damaged and hostile archives."""

import io
import struct
import tracemalloc
import zipfile

import numpy as np
import pytest

from drone_env.errors import InvalidValueError
from drone_env.npz import unpack_arrays

MOST = 1 << 20


def array(value: object) -> bytes:
    file = io.BytesIO()
    np.save(file, np.asarray(value), allow_pickle=True)
    return file.getvalue()


def packed(content: bytes, compression: int = zipfile.ZIP_DEFLATED) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", compression) as archive:
        archive.writestr("values.npy", content)
    return file.getvalue()


def claiming(text: str) -> bytes:
    """An array without values, with this header."""
    return packed(b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text.encode())


def lying() -> bytes:
    """30 MB of zeros in an entry that claims 100 bytes."""
    return packed(bytes(30_000_000)).replace(struct.pack("<I", 30_000_000), struct.pack("<I", 100))


@pytest.mark.parametrize(
    ("content", "why"),
    [
        pytest.param(packed(bytes(30_000_000)), "unpacked it would have 30", id="a bomb"),
        pytest.param(lying(), None, id="a bomb that lies"),
        pytest.param(packed(array(5))[:-30], "not a zip file", id="cut short"),
        pytest.param(packed(array(5), zipfile.ZIP_LZMA), "packed in a way", id="another compression"),
        pytest.param(claiming(f"{{'descr': '<f4', 'fortran_order': False, 'shape': ({10**15},), }}\n"), "has 0",
                     id="more than there is"),
        pytest.param(claiming("-" * 9000 + "1\n"), None, id="a nested header"),
        pytest.param(packed(array([print])), None, id="objects"),
    ],
)  # fmt: skip
def test_a_hostile_archive_is_refused_in_bounded_memory(content: bytes, why: str | None) -> None:
    assert unpack_arrays(packed(array(5)), MOST)["values"] == 5
    tracemalloc.start()
    try:
        with pytest.raises(InvalidValueError, match=why):
            unpack_arrays(content, MOST)
        assert tracemalloc.get_traced_memory()[1] < 8_000_000
    finally:
        tracemalloc.stop()
