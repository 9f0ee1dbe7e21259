"""Commands of ``train`` as work for the engine: run one of them with given options, in silence."""

from __future__ import annotations

import importlib
import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from harness.command import PlainConsole
from harness.provenance import begin


@dataclass(frozen=True, eq=False)
class Job:
    """A command, its options and the command line that results will name."""

    command: str
    options: Any
    words: list[str]


def run(job: Job) -> Path:
    """Runs a command whose work is a run; its folder. A run that is done is left alone."""
    begin("python -m train", job.words)
    module: Any = importlib.import_module(f"train.{job.command}")
    module.train(job.options, PlainConsole(file=io.StringIO()))
    folder: Path = job.options.run.out
    return folder
