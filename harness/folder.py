"""The folder that a command writes to: its own until it ends, refused, replaced or resumed."""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from snake_env.errors import InvalidInputError
from snake_env.system.files import is_stray

Found = Literal["nothing", "begun", "finished"]
"""What a folder holds of the work that a command is to do there."""


@dataclass(frozen=True)
class Layout:
    """What a command's folder holds.

    Attributes:
        begun: A file that is there once the work has begun; it goes last, when all else is there.
        done: A file that is there when the work is done.
        own: Patterns of all that the command may write, replaced by --overwrite.
    """

    begun: str
    done: str
    own: tuple[str, ...]

    def found(self, folder: Path) -> Found:
        """How far the work in a folder is."""
        if (folder / self.begun).exists():
            return "begun"
        return "finished" if (folder / self.done).exists() else "nothing"


@contextmanager
def held(
    folder: Path | None, layout: Layout, *, overwrite: bool = False, resume: bool = False
) -> Iterator[Found]:
    """Makes a folder this process's own; no other one is let in before it ends, however it ends.

    What a killed process left of a file that it was writing is removed once the folder is accepted.

    Args:
        folder: The folder, made where there is none; None: nothing is written.
        layout: What is in it.
        overwrite: Whether results that are there may go.
        resume: Whether to continue what is there; where there is nothing, it begins.

    Yields:
        What there is to continue.

    Raises:
        InvalidInputError: It can't be written, another process writes to it, it holds results that may
            not go, or something else.
    """
    if folder is None:
        yield "nothing"
        return
    writable_folder(folder)
    with _locked(folder):
        found = layout.found(folder)
        strays = [path for path in folder.iterdir() if is_stray(path)]
        if len(strays) < len(list(folder.iterdir())):
            if found == "nothing":
                expected = "an empty folder, or one with a run"
                raise InvalidInputError("out", str(folder), expected)
            if not (overwrite or resume):
                expected = "an empty folder (or --overwrite to replace what is there, or --resume)"
                raise InvalidInputError("out", str(folder), expected)
        for path in strays:
            path.unlink()
        if overwrite:
            _clear(folder, layout)
            found = "nothing"
        yield found


def writable_folder(folder: Path) -> None:
    """Makes a folder where there is none yet.

    Raises:
        InvalidInputError: It can't be made, or not written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except (OSError, ValueError) as error:  # ValueError: a null character
        reason = getattr(error, "strerror", None) or error
        raise InvalidInputError("out", str(folder), f"a folder to write to ({reason})") from None


def _clear(folder: Path, layout: Layout) -> None:
    """Removes what is the command's own, last the files by which it is known as such."""
    last = [folder / layout.done, folder / layout.begun]
    own = {path for pattern in layout.own for path in folder.glob(pattern)}
    for path in [*(own - {*last}), *last]:
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Keeps other processes out; the system forgets the lock when this one ends, even by a kill."""
    try:
        handle = _lock(folder)
    except (BlockingIOError, FileExistsError):
        expected = "a folder that no other process is writing to (one is: wait, or choose another)"
        raise InvalidInputError("out", str(folder), expected) from None
    except OSError:
        handle = None  # a file system without locks
    try:
        yield
    finally:
        if handle is not None:
            os.close(handle)


def _lock(folder: Path) -> int:
    if sys.platform == "win32":  # the file goes with its owner
        file = folder.absolute().with_name(f".{folder.absolute().name}.lock")
        return os.open(file, os.O_CREAT | os.O_EXCL | os.O_TEMPORARY)
    import fcntl

    handle = os.open(folder, os.O_RDONLY)  # a folder itself can be locked
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BaseException:
        os.close(handle)
        raise
    return handle
