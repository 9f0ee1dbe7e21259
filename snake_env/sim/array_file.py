"""Reads arrays of numbers from ``.npz`` files that anybody may have made: without pickle, in bounds."""

from __future__ import annotations

import io
import math
import tokenize
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

LARGEST = 256 * 2**20
"""Bytes that an array may have, unless a caller says otherwise."""
_HEADER = 10_000  # bytes; those of plain arrays have about 100
_PROBLEMS = (
    *(OSError, ValueError, TypeError, EOFError, OverflowError, MemoryError, zlib.error),
    *(RuntimeError, NotImplementedError),  # encrypted or of a foreign compression
    *(SyntaxError, tokenize.TokenError),  # a header that is no Python literal
)


class ArrayFileError(ValueError):
    """The file can't be read, or does not hold the arrays; the text is the reason."""


def read_arrays(path: Path, *names: str, most: int = LARGEST) -> dict[str, NDArray[Any]]:
    """The named arrays of a file; whatever else is in it is not looked at.

    Args:
        path: The ``.npz`` file.
        names: Arrays of real numbers that it must hold.
        most: Bytes that each of them may have at most.

    Raises:
        ArrayFileError: It is no such file, or one of the arrays is missing, damaged or too large.
    """
    try:
        if not path.is_file():
            raise ArrayFileError("the file does not exist")
        with zipfile.ZipFile(path) as archive:
            members = archive.namelist()
            for name in names:
                if f"{name}.npy" not in members:
                    raise ArrayFileError(f"it has no array {name}")
            return {name: _read(archive, name, most) for name in names}
    except zipfile.BadZipFile as error:
        reason = "not a valid zip file; pickled objects are never read"
        raise ArrayFileError(f"{reason}: {error}") from None
    except _PROBLEMS as error:
        raise ArrayFileError(str(error) or type(error).__name__) from None


def _read(archive: zipfile.ZipFile, name: str, most: int) -> NDArray[Any]:
    member = archive.getinfo(f"{name}.npy")
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise ArrayFileError(f"{name} is compressed in a way that numpy.savez never uses")
    with archive.open(member) as file:
        start = io.BytesIO(file.read(12 + _HEADER))
        version = npy.read_magic(start)
        if version not in ((1, 0), (2, 0)):
            raise ArrayFileError(f"{name} has the unknown .npy version {version}")
        read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
        shape, fortran, dtype = read(start, max_header_size=_HEADER)
        if dtype.hasobject:
            raise ArrayFileError("pickled objects are never read")
        if dtype.kind not in "fiu":
            raise ArrayFileError(f"{name} holds {dtype}, not real numbers")
        if any(size < 0 for size in shape) or len(shape) > 4:
            raise ArrayFileError(f"{name} has the shape {shape}")
        size = math.prod(shape) * dtype.itemsize
        if size > most:
            raise ArrayFileError(f"{name} has {size:,} bytes; at most {most:,} are read")
        data = start.read() + file.read(max(0, size - (len(start.getvalue()) - start.tell())) + 1)
    return np.frombuffer(_whole(name, data, size), dtype).reshape(
        shape, order="F" if fortran else "C"
    )


def _whole(name: str, data: bytes, size: int) -> bytes:
    if len(data) != size:
        more = "more" if len(data) > size else "fewer"
        raise ArrayFileError(f"{name} has {more} bytes than its header says ({size:,})")
    return data
