"""Files that are read in bounds, and names of files."""

from __future__ import annotations

import hashlib
import json
import re
from pathlib import Path
from typing import Any, NoReturn

LARGEST = 256 * 2**20
"""Bytes that are read of a file, unless a caller says otherwise."""
_LONGEST_NAME = 60  # characters; with what stands around it far below the 255 bytes of file systems


class FileError(ValueError):
    """A file that can't be read; the text is the reason."""


def read_bytes(path: Path, most: int = LARGEST) -> bytes:
    """The content of a file.

    Raises:
        FileError: It is no file that exists, can't be read, or has more than ``most`` bytes.
    """
    try:
        size = path.stat().st_size
        if not path.is_file():
            raise FileError("not a regular file")
        if size > most:
            raise FileError(f"it has {size:,} bytes; at most {most:,} are read")
        return path.read_bytes()
    except OSError as error:
        raise FileError(error.strerror or str(error)) from None
    except ValueError as error:  # a null character in the path
        raise FileError(str(error)) from None


def read_text(path: Path, most: int = LARGEST) -> str:
    """The text in a file.

    Raises:
        FileError: As :func:`read_bytes`, or it is not UTF-8 text.
    """
    try:
        return read_bytes(path, most).decode()
    except UnicodeDecodeError:
        raise FileError("not UTF-8 text") from None


def read_json(path: Path, most: int = LARGEST) -> Any:
    """The value in a file of JSON.

    Raises:
        FileError: As :func:`read_text`, or it is not JSON.
    """
    return parsed_json(read_text(path, most))


def parsed_json(text: str) -> Any:
    """The value of a text in JSON: NaN and Infinity are none.

    Raises:
        FileError: It is no JSON, or nested too deeply.
    """
    try:
        return json.loads(text, parse_constant=_refuse)
    except RecursionError:
        raise FileError("it is nested too deeply") from None
    except ValueError as error:
        raise FileError(f"invalid JSON: {error}") from None


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f"JSON has no {constant}")


def file_name(name: str) -> str:
    """A policy's or a suite's name or path as part of a file's name: safe, short, and its own.

    Names that differ, be it in the case of letters, have different results.
    """
    safe = re.sub(r"[^A-Za-z0-9_.+=,-]+", "-", name.removesuffix(".safetensors")).strip("-.")
    safe = safe[-_LONGEST_NAME:].lower()  # of a path the end matters
    if safe == name:
        return safe
    digest = hashlib.sha256(name.encode(errors="surrogatepass")).hexdigest()[:8]
    return f"{safe}-{digest}" if safe else digest
