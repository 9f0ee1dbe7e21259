"""Finished pieces of long work, line by line, so that a killed run loses none of them."""

from __future__ import annotations

import json
import os
import tempfile
from pathlib import Path
from typing import Any

from snake_env.errors import InvalidInputError


class Journal:
    """A file of JSON lines: first what decides the work's results, then its finished pieces.

    Args:
        path: The file.
        config: What decides the results; work that is resumed must have the same.
        resume: Whether to go on with the work in the file; otherwise it begins anew.

    Attributes:
        entries: The finished pieces that the file held.

    Raises:
        InvalidInputError: There is nothing to resume, or another work.
    """

    def __init__(self, path: Path, config: dict[str, Any], *, resume: bool) -> None:
        self._path = path
        self.entries: list[dict[str, Any]] = []
        header = json.dumps({"config": config})
        if resume:
            self._read(header)
        lines = [header, *(json.dumps(entry) for entry in self.entries)]
        write_atomically(path, "\n".join(lines) + "\n")

    def append(self, entry: dict[str, Any]) -> None:
        """Takes a finished piece."""
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(entry) + "\n")

    def remove(self) -> None:
        """Removes the file: the work is done and its results are elsewhere."""
        self._path.unlink(missing_ok=True)

    def _read(self, header: str) -> None:
        folder = str(self._path.parent)
        if not self._path.is_file():
            raise InvalidInputError("resume", folder, "a folder with an interrupted run")
        lines = self._path.read_text(encoding="utf-8", errors="replace").splitlines()
        if not lines or lines[0] != header:
            expected = "work with the same policies, tasks, options and constants"
            raise InvalidInputError("resume", folder, expected)
        for line in lines[1:]:
            try:
                self.entries.append(json.loads(line))
            except ValueError:
                continue  # the line that a kill tore off


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
    file = tempfile.NamedTemporaryFile(  # noqa: SIM115  # closed below, before it is renamed
        "wb", dir=path.parent, delete=False
    )
    try:
        with file:
            file.write(data)
        os.chmod(file.name, 0o644)
        os.replace(file.name, path)
    except BaseException:
        Path(file.name).unlink(missing_ok=True)
        raise
