"""Arrays in NumPy's `.npz` that somebody else wrote, read without pickle and in bounded memory."""

import math
import struct
import tokenize
import zlib
from io import BytesIO
from typing import Any
from zipfile import ZIP_DEFLATED, ZIP_STORED, BadZipFile, ZipFile, ZipInfo

import numpy as np
import numpy.typing as npt

from drone_env.errors import InvalidValueError

UNREADABLE = (ValueError, TypeError, BadZipFile, zlib.error, struct.error, EOFError, NotImplementedError,
              RecursionError, MemoryError, OverflowError, SyntaxError, tokenize.TokenError)  # fmt: skip
"""What a malformed archive or array raises. Sizes are checked before, so memory is that of the parser."""


def unpack_arrays(content: bytes, most: int) -> dict[str, npt.NDArray[Any]]:
    """The arrays in the bytes of a `.npz` file, by name.

    Args:
        content: The file.
        most: Bytes that its entries may have, unpacked and together.

    Raises:
        InvalidValueError: if it is not such a file, holds objects, or is larger.
    """
    try:
        with ZipFile(BytesIO(content)) as archive:
            entries = archive.infolist()
            declared = sum(entry.file_size for entry in entries)
            if declared > most:
                raise ValueError(f"unpacked it would have {declared} bytes; at most {most} are allowed")
            return {entry.filename.removesuffix(".npy"): _array(archive, entry) for entry in entries}
    except UNREADABLE as error:
        raise InvalidValueError(str(error) or type(error).__name__) from None


def _array(archive: ZipFile, entry: ZipInfo) -> npt.NDArray[Any]:
    """The array in an entry. NumPy's own reader allocates as many values as the header claims."""
    if entry.flag_bits & 1 or entry.compress_type not in (ZIP_STORED, ZIP_DEFLATED):
        raise ValueError(f"{entry.filename} is encrypted, or packed in a way that NumPy does not write")
    with archive.open(entry) as opened:
        # Bounded: read without a number, an entry that lies about its size would be unpacked whole.
        content = opened.read(entry.file_size + 1)
    file = BytesIO(content)
    version = np.lib.format.read_magic(file)
    if version != (1, 0):
        raise ValueError(f"it has arrays of version {version}; only (1, 0) is read")
    shape, by_columns, dtype = np.lib.format.read_array_header_1_0(file)
    values = np.frombuffer(content[file.tell() :], dtype)
    if values.shape != (math.prod(shape),):
        raise ValueError(f"an array of {list(shape)} values has {len(values)}")
    return values.reshape(shape, order="F" if by_columns else "C").copy()
