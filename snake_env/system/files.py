"""Files that a killed process or a full disk can't leave half-written."""

from __future__ import annotations

import io
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TextIO


def write_atomically(path: Path, content: str | bytes) -> None:
    """Writes a file so that a reader sees the old one or the whole new one."""
    data = content.encode() if isinstance(content, str) else content
    with replacing(path) as file:
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
def replacing(path: Path) -> Iterator[IO[bytes]]:
    """A file to write to, which takes the place of the old one when it is complete."""
    file = tempfile.NamedTemporaryFile(  # noqa: SIM115  # closed below, before it is renamed
        "wb", dir=path.parent, delete=False
    )
    try:
        with file:
            yield file
        os.chmod(file.name, 0o644)  # temporary files are their owner's alone
        os.replace(file.name, path)
    except BaseException:
        Path(file.name).unlink(missing_ok=True)
        raise
