"""The run folder: what was asked for, with what, and how it went."""

from __future__ import annotations

import csv
import hashlib
import io
import json
import os
import platform
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from harness.folder import Layout, held
from harness.provenance import command, revision
from harness.robot import Robot
from snake_env.errors import InvalidInputError
from snake_env.system.files import write_atomically
from train.records import ABOUT, SCHEMA, read_about, read_log

_PACKAGES = ("snake-mode-env", "numpy", "gymnasium", "torch", "stable-baselines3", "safetensors")


@dataclass(frozen=True)
class Run:
    """Run folder and seeds."""

    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Run folder. Default: runs/ALGORITHM-ROBOT-sSEED; a recipe's ALGORITHM is recipe-BUDGET."""
    seed: int = 0
    """Random seed."""
    seeds: int = 1
    """Number of consecutive seeds, trained in parallel. The run folders end in -s0, -s1, ...; the
    folder with all learning curves ends in -seeds."""
    resume: bool = False
    """Continue the interrupted run in the folder; without one, start it."""
    overwrite: bool = False
    """Replace the run in the folder."""

    def folder(self, name: str) -> Path:
        """The folder of a run with this name.

        Raises:
            InvalidInputError: Options that can't be used.
        """
        if not 0 <= self.seed < 2**31:
            raise InvalidInputError("seed", self.seed, "an integer from 0 to 2^31 - 1")
        if self.overwrite and self.resume:
            raise InvalidInputError("overwrite", True, "one of --overwrite and --resume")
        return self.out if self.out is not None else Path("runs") / f"{name}-s{self.seed}"

    def own(self, path: Path) -> Path:
        """A path that an option gives, with the run's seed in the place of ``{seed}``."""
        return Path(str(path).replace("{seed}", str(self.seed)))


def part_seed(seed: int, part: int) -> int:
    """The seed of a part of a run: a segment, a round or a generation."""
    return int(np.random.SeedSequence([seed, part]).generate_state(1)[0]) // 2


LAYOUT = Layout(
    begun=ABOUT,
    done=ABOUT,
    own=(
        *(ABOUT, "log.csv", "curve.png", "tensorboard", "checkpoint.pt"),
        *("best.safetensors", "last.safetensors", "value.safetensors"),
        *("round-*.safetensors", "labels-*.npz", "value-*.safetensors", "returns-*.npz"),
    ),
)
"""What the folder of a run holds."""


class RunFolder:
    """A run on disk: ``run.json`` says what was asked for, ``log.csv`` how it went.

    As a context it keeps other processes out, and holds what is to be resumed, or a new run.

    Args:
        run: Where it is kept.
        algorithm: What learns.
        robot: The robot; with the algorithm and the seed it names the folder where ``run`` does not.
        config: What decides the result; a resumed run must have the same.
        layout: What the folder holds.

    Attributes:
        path: The folder.
        digest: Of the config; it tells one run from another.

    Raises:
        InvalidInputError: The folder can't be used, or holds another run.
    """

    def __init__(
        self,
        run: Run,
        algorithm: str,
        robot: Robot,
        config: dict[str, Any],
        layout: Layout = LAYOUT,
    ) -> None:
        self.path = run.folder(f"{algorithm}-{robot.name}")
        self.config = json.loads(json.dumps(config, default=str))
        self.digest = hashlib.sha256(json.dumps(self.config, sort_keys=True).encode()).hexdigest()
        self._algorithm, self._robot = algorithm, robot.name
        self._held = held(self.path, layout, overwrite=run.overwrite, resume=run.resume)
        self._log = self.path / "log.csv"

    def __enter__(self) -> RunFolder:
        if self._held.__enter__() == "begun":
            try:
                self._check(read_about(self.path, "resume"))
            except BaseException:
                self._held.__exit__(*sys.exc_info())
                raise
        else:
            about = json.dumps(self._about(), indent=1) + "\n"
            write_atomically(self.path / LAYOUT.begun, about)
        return self

    def __exit__(self, *problem: Any) -> None:
        self._held.__exit__(*problem)

    def _check(self, about: dict[str, Any]) -> None:
        there = about["config"]
        if there != self.config:
            differing = sorted(
                key
                for key in {*there, *self.config}
                if there.get(key, self) != self.config.get(key, self)
            )
            expected = f"a run with the same options (these differ: {', '.join(differing)})"
            raise InvalidInputError("resume", str(self.path), expected)

    def _about(self) -> dict[str, Any]:
        return {
            "schema": SCHEMA,
            "algorithm": self._algorithm,
            "robot": self._robot,
            "command": command(),
            "config": self.config,
            "git": revision(),
            "python": platform.python_version(),
            "versions": {name: _version(name) for name in _PACKAGES},
            "machine": {"processor": platform.machine(), "cores": os.cpu_count()},
        }

    def rows(self, counter: str) -> list[dict[str, str]]:
        """The log so far.

        Args:
            counter: The column that says how far the run was.

        Raises:
            InvalidInputError: It is damaged.
        """
        return read_log(self._log, counter) if self._log.exists() else []

    def write_rows(self, rows: Iterable[dict[str, Any]]) -> None:
        """Replaces the log."""
        text = io.StringIO()
        writer: csv.DictWriter[str] | None = None
        for row in rows:
            if writer is None:
                writer = csv.DictWriter(text, fieldnames=list(row), lineterminator="\n")
                writer.writeheader()
            writer.writerow(row)
        write_atomically(self._log, text.getvalue())


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None
