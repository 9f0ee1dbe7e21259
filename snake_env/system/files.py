"""Files that a killed process or a full disk can't leave half-written."""

from __future__ import annotations

import io
import os
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TextIO

_PREFIX, _SUFFIX = ".snake-env-", ".tmp"  # of what is being written
_UMASK = os.umask(0)
os.umask(_UMASK)  # it can't be read in another way


def write_atomically(path: Path, content: str | bytes, mode: int = 0o666 & ~_UMASK) -> None:
    """Writes a file so that a reader sees the old one or the whole new one.

    Args:
        path: The file.
        content: What it holds.
        mode: Its permissions; those of any new file where they are not given.
    """
    data = content.encode() if isinstance(content, str) else content
    with replacing(path, mode) as file:
        file.write(data)


@contextmanager
def atomic_writer(path: Path) -> Iterator[TextIO]:
    """A text file to write to, which takes the place of the old one when it is complete."""
    with (
        replacing(path) as file,
        io.TextIOWrapper(file, encoding="utf-8", newline="") as text,
    ):
        yield text


@contextmanager
def replacing(path: Path, mode: int = 0o666 & ~_UMASK) -> Iterator[IO[bytes]]:
    """A file to write to, which takes the place of the old one when it is complete."""
    file = tempfile.NamedTemporaryFile(  # noqa: SIM115  # closed below, before it is renamed
        "wb", dir=path.parent, prefix=_PREFIX, suffix=_SUFFIX, delete=False
    )
    try:
        with file:
            yield file
        os.chmod(file.name, mode)  # temporary files are their owner's alone
        os.replace(file.name, path)
    except BaseException:
        Path(file.name).unlink(missing_ok=True)
        raise


def is_stray(path: Path) -> bool:
    """Whether it is what a killed process left of a file that it was writing."""
    pattern = rf"{re.escape(_PREFIX)}[a-z0-9_]{{8}}{re.escape(_SUFFIX)}"
    return re.fullmatch(pattern, path.name) is not None and path.is_file()
