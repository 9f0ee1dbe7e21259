"""Commands of ``train`` as work for the engine: each writes what it says to a log."""

from __future__ import annotations

import contextlib
import importlib
import threading
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from harness.console import PlainConsole
from harness.engine import Engine
from harness.provenance import begin

_EVERY_S = 20.0


@dataclass(frozen=True, eq=False)
class Job:
    """A command whose work is a run.

    Attributes:
        command: What learns.
        options: The command's options.
        words: The command line that results will name.
    """

    command: str
    options: Any
    words: list[str]

    @property
    def folder(self) -> Path:
        """The run's folder."""
        folder: Path = self.options.run.out
        return folder

    def train(self, console: Console) -> None:
        """Runs the command here."""
        module: Any = importlib.import_module(f"train.{self.command}")
        module.train(self.options, console)

    @property
    def log(self) -> Path:
        """What the command says, beside the run's folder."""
        return self.folder.with_name(f"{self.folder.name}.log")


def run(job: Job) -> Path:
    """Runs a command; its folder. A run that is finished is left alone."""
    begin("python -m train", job.words)
    job.log.parent.mkdir(parents=True, exist_ok=True)
    with job.log.open("a", encoding="utf-8") as file:
        job.train(PlainConsole(file=file, width=100))
    return job.folder


def side_by_side(jobs: Sequence[Job], engine: Engine, console: Console) -> None:
    """Runs several commands, each in a worker, and shows what they say."""
    with _followed(jobs, console), closing(engine.map(run, jobs)) as finished:
        for folder in finished:
            console.print(f"{folder}: done", soft_wrap=True)


@contextmanager
def _followed(jobs: Sequence[Job], console: Console) -> Iterator[None]:
    """Shows the last line of each log now and then, as far as this machine writes them."""
    read = {job.log: job.log.stat().st_size if job.log.exists() else 0 for job in jobs}
    over = threading.Event()

    def follow() -> None:
        while not over.wait(_EVERY_S):
            for log, start in read.items():
                with contextlib.suppress(OSError), log.open("rb") as file:
                    file.seek(start)
                    whole, newline, _ = file.read().rpartition(b"\n")
                    read[log] = start + len(whole) + len(newline)
                    if newline:
                        last = whole.rpartition(b"\n")[2].decode("utf-8", "replace")
                        console.print(last, soft_wrap=True)

    thread = threading.Thread(target=follow, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
