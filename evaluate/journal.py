"""Finished pieces of long work, line by line, so that a killed run loses none of them."""

from __future__ import annotations

import io
import json
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, TextIO

from snake_env.errors import InvalidInputError


class Journal:
    """A file of JSON lines: first what decides the work's results, then its finished pieces.

    Args:
        path: The file.
        config: What decides the results; work that is resumed must have the same.
        resume: Whether to go on with the work in the file; otherwise it begins anew.
        take: Gets each finished piece that the file held, with a ValueError for one it can't use;
            default: they are kept in ``entries``.

    Attributes:
        entries: The finished pieces that the file held.

    Raises:
        InvalidInputError: There is nothing to resume, another work, or a piece that can't be used.
    """

    def __init__(
        self,
        path: Path,
        config: dict[str, Any],
        *,
        resume: bool,
        take: Callable[[Any], None] | None = None,
    ) -> None:
        self._path = path
        self.entries: list[dict[str, Any]] = []
        header = json.dumps({"config": config})
        if not resume:
            write_atomically(path, header + "\n")
            return
        if not path.is_file():
            raise InvalidInputError("resume", str(path.parent), "a folder with an interrupted run")
        self._restore(header, take or self.entries.append)

    def append(self, entry: dict[str, Any]) -> None:
        """Takes a finished piece."""
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(entry) + "\n")

    def remove(self) -> None:
        """Removes the file: the work is done and its results are elsewhere."""
        self._path.unlink(missing_ok=True)

    def _restore(self, header: str, take: Callable[[Any], None]) -> None:
        """Reads the pieces, and writes the file anew without the line that a kill tore off."""
        with (
            self._path.open(encoding="utf-8", errors="replace") as lines,
            atomic_writer(self._path) as whole,
        ):
            if lines.readline().rstrip("\n") != header:
                expected = "work with the same policies, tasks, options and constants"
                raise InvalidInputError("resume", str(self._path.parent), expected)
            whole.write(header + "\n")
            for number, line in enumerate(lines, start=2):
                try:
                    entry = json.loads(line)
                except ValueError:
                    continue  # it is begun again
                try:
                    take(entry)
                except (ValueError, TypeError, LookupError, AttributeError):
                    raise InvalidInputError(
                        f"resume: line {number} of {self._path}",
                        line.rstrip("\n"),
                        "a finished piece of this work (--overwrite begins anew)",
                    ) from None
                whole.write(line.rstrip("\n") + "\n")


def writable_folder(folder: Path) -> None:
    """Makes a folder where there is none yet.

    Raises:
        InvalidInputError: It can't be made, or not written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        expected = f"a folder to write to ({error.strerror})"
        raise InvalidInputError("out", str(folder), expected) from None


def write_atomically(path: Path, content: str | bytes) -> None:
    """Writes a file so that a reader sees the old one or the whole new one."""
    data = content.encode() if isinstance(content, str) else content
    with _replacing(path) as file:
        file.write(data)


@contextmanager
def atomic_writer(path: Path) -> Iterator[TextIO]:
    """A text file to write to, which takes the place of the old one when it is complete."""
    with (
        _replacing(path) as file,
        io.TextIOWrapper(file, encoding="utf-8", newline="") as text,
    ):
        yield text


@contextmanager
def _replacing(path: Path) -> Iterator[IO[bytes]]:
    file = tempfile.NamedTemporaryFile(  # noqa: SIM115  # closed below, before it is renamed
        "wb", dir=path.parent, delete=False
    )
    try:
        with file:
            yield file
        os.chmod(file.name, 0o644)
        os.replace(file.name, path)
    except BaseException:
        Path(file.name).unlink(missing_ok=True)
        raise
