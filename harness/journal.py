"""Finished pieces of long work, line by line, so that a killed run loses none of them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from harness.files import FileError, read_json
from snake_env.errors import InvalidInputError
from snake_env.system.files import atomic_writer, write_atomically

_SAME = "work with the same policies, tasks, options and constants (or --overwrite)"
_LONGEST_LINE = 64 * 2**20  # characters of a finished piece


class Journal:
    """A file of JSON lines: first what decides the work's results, then its finished pieces.

    Args:
        path: The file.
        config: What decides the results; work that is resumed must have the same.
        resume: Whether to continue the work in the file; otherwise it is replaced.
        take: Gets each finished piece that the file held; raises what Python does about bad values
            where it can't use one.

    Raises:
        InvalidInputError: It is another work that would be resumed, or a piece can't be used.
    """

    def __init__(
        self,
        path: Path,
        config: dict[str, Any],
        *,
        resume: bool,
        take: Callable[[Any], None],
    ) -> None:
        self._path = path
        header = json.dumps({"config": config})
        if resume:
            self._restore(header, take)
        else:
            write_atomically(path, header + "\n")

    def append(self, entry: dict[str, Any]) -> None:
        """Takes a finished piece."""
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(entry) + "\n")

    def remove(self) -> None:
        """Removes the file: the work is done and its results are elsewhere."""
        self._path.unlink(missing_ok=True)

    def _restore(self, header: str, take: Callable[[Any], None]) -> None:
        """Reads the pieces, and writes the file again without the line that a kill tore off."""
        with (
            self._path.open(encoding="utf-8", errors="replace") as lines,
            atomic_writer(self._path) as whole,
        ):
            if lines.readline(_LONGEST_LINE).rstrip("\n") != header:
                raise InvalidInputError("resume", str(self._path.parent), _SAME)
            whole.write(header + "\n")
            number = 1
            while line := lines.readline(_LONGEST_LINE):
                number += 1
                try:
                    entry = json.loads(line)
                except (ValueError, RecursionError):
                    continue  # it is begun again
                try:
                    take(entry)
                except (ValueError, TypeError, LookupError, AttributeError, OverflowError):
                    raise InvalidInputError(
                        f"resume: line {number} of {self._path}",
                        line.rstrip("\n"),
                        "a finished piece of this work (or --overwrite to begin again)",
                    ) from None
                whole.write(line.rstrip("\n") + "\n")


def check_finished(path: Path, config: dict[str, Any]) -> None:
    """Checks whether finished work is the one that is asked for.

    Args:
        path: A file of JSON with the work's config.
        config: What decides the results.

    Raises:
        InvalidInputError: It is another work, or the file is damaged.
    """
    try:
        there = read_json(path)
        same = all(there[key] == value for key, value in json.loads(json.dumps(config)).items())
    except (FileError, TypeError, LookupError) as error:
        expected = f"finished work ({path.name}: {error})"
        raise InvalidInputError("resume", str(path.parent), expected) from None
    if not same:
        raise InvalidInputError("resume", str(path.parent), _SAME)
