"""A command, run in this process or in one of its own, and interrupted at will."""

import csv
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest

from harness.engine import Engine
from tests.support import HANGS_S, ROOT

QUICK = ("--set", "n_joints=5", "--workers", "1")
"""Options of a robot that costs little."""


class Command:
    """``python -m`` train or evaluate.

    Args:
        main: The function that runs it.
    """

    def __init__(self, main: Callable[[list[str]], int]) -> None:
        self._main = main
        self._package = main.__module__.split(".")[0]

    def run(self, *arguments: object) -> int:
        """Its exit code."""
        try:
            return self._main([str(argument) for argument in arguments])
        except SystemExit as end:
            return int(end.code or 0)

    def good(self, *arguments: object) -> None:
        """Runs it to a good end."""
        assert self.run(*arguments) == 0

    def refusal(self, capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
        """What is said about bad arguments: one line, no traceback, and nothing else."""
        capsys.readouterr()
        assert self.run(*arguments) == 2
        stdout, stderr = capsys.readouterr()
        assert stdout == ""
        assert re.fullmatch(r"error: [^\n]+\n", stderr), stderr
        return stderr.strip().removeprefix("error: ")

    def interrupt(self, after: int, *arguments: object) -> None:
        """Runs it up to Ctrl-C after so many pieces of work."""
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(Engine, "map", Interrupted(after))
            assert self.run(*arguments) == 130

    def start(self, *arguments: object, **variables: str) -> subprocess.Popen[str]:
        """Begins it in a process of its own: see :func:`start_python`."""
        return start_python("-m", self._package, *arguments, **variables)

    def process(
        self, *arguments: object, code: int = 0, **variables: str
    ) -> subprocess.CompletedProcess[str]:
        """Runs it in a process of its own: see :func:`python`."""
        return python("-m", self._package, *arguments, code=code, **variables)


def start_python(*words: object, **variables: str) -> subprocess.Popen[str]:
    """Begins Python in the checkout, in a session of its own.

    Args:
        *words: The command line.
        **variables: Added to the environment.
    """
    return subprocess.Popen(
        [sys.executable, *map(str, words)],
        cwd=ROOT, text=True, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, start_new_session=True, env={**os.environ, **variables},
    )  # fmt: skip


def wait_until(happened: Callable[[], object], process: subprocess.Popen[Any]) -> None:
    """Waits for what a process does while it runs."""
    deadline = time.monotonic() + HANGS_S
    while not happened():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.005)


def python(*words: object, code: int = 0, **variables: str) -> subprocess.CompletedProcess[str]:
    """Runs Python in the checkout, up to an exit code."""
    process = start_python(*words, **variables)
    try:
        stdout, stderr = process.communicate(timeout=HANGS_S)
    finally:
        process.kill()  # where it hangs
    assert process.returncode == code, stdout + stderr
    return subprocess.CompletedProcess(process.args, code, stdout, stderr)


class Interrupted:
    """Takes the place of ``Engine.map``: Ctrl-C after so many pieces of work, of all calls."""

    def __init__(self, after: int) -> None:
        self.left = after

    def __get__(self, engine: Engine, owner: type[Engine]) -> Callable[..., Iterator[Any]]:
        return self.map

    def map(self, work: Callable[[Any], Any], pieces: Iterable[Any]) -> Iterator[Any]:
        """Works here, piece by piece."""
        for piece in pieces:
            if self.left == 0:
                raise KeyboardInterrupt
            self.left -= 1
            yield work(piece)


def tree(folder: Path) -> dict[str, bytes]:
    """Everything in a folder, with its content."""
    paths = sorted(folder.rglob("*"))
    return {str(path): path.read_bytes() if path.is_file() else b"" for path in paths}


def read_csv(path: Path) -> list[dict[str, str]]:
    """The rows of a table."""
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def names(folder: Path) -> set[str]:
    """The names in a folder."""
    return {path.name for path in folder.iterdir()}
