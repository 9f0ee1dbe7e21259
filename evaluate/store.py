"""The result folder: finished shards as they come, then ``episodes.csv`` and ``summary.json``.

Every shard is appended to ``episodes.partial.jsonl`` as one line when it is done. A killed run leaves
at worst one torn last line there, which is dropped when the run is resumed.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evaluate.journal import Journal, atomic_writer, writable_folder, write_atomically
from evaluate.protocol import COLUMNS, Row
from evaluate.rows import Rows, pack
from snake_env.errors import InvalidInputError

PARTIAL = "episodes.partial.jsonl"
_STALE = (
    *("episodes.csv", "summary.json", "report.html"),
    *("fig4-*.png", "sim-1-*.png", "video-*.*"),
)


class Store:
    """Results of a run, in memory and (if there is a folder) on disk.

    Args:
        folder: Where results go; None: nowhere.
        config: What decides the results; a resumed run must have the same. Its ``policies`` name the
            policies, its ``tasks`` the number ``n`` of tasks.
        overwrite: Whether results that are there already may go.
        resume: Whether to go on with an interrupted run.

    Attributes:
        done: How many episodes are finished.

    Raises:
        InvalidInputError: The folder can't be written, holds results, a run with another config, or a
            damaged one.
    """

    def __init__(
        self, folder: Path | None, config: dict[str, Any], *, overwrite: bool, resume: bool
    ) -> None:
        self.folder = folder
        self.done = 0
        self._packed: dict[str, list[NDArray[np.void]]] = {}
        self._finished: dict[str, NDArray[np.bool_]] = {
            policy: np.zeros(config["tasks"]["n"], dtype=np.bool_) for policy in config["policies"]
        }
        if folder is None:
            return
        path = folder / PARTIAL
        if resume and not path.is_file():
            raise InvalidInputError("resume", str(folder), "a folder with an interrupted run")
        writable_folder(folder)
        if not resume:
            _clear(folder, overwrite)
        self._journal = Journal(
            path, config, resume=resume, take=lambda entry: self._take(entry["rows"])
        )

    def add(self, rows: list[Row]) -> None:
        """Takes a finished shard."""
        self._take(rows)
        if self.folder is not None:
            self._journal.append({"rows": rows})

    def _take(self, rows: list[Row]) -> None:
        packed = pack(rows)
        policies = set(packed["policy"])
        tasks = packed["task"]
        if len(policies) != 1 or np.any(tasks < 0):
            raise ValueError("a shard is episodes of one policy")
        policy = policies.pop()
        finished = self._finished[policy]
        if finished[tasks].any() or len(np.unique(tasks)) != len(tasks):
            raise ValueError("a task is there twice")
        finished[tasks] = True
        self._packed.setdefault(policy, []).append(packed)
        self.done += len(packed)

    def missing(self, policy: str) -> list[int]:
        """The tasks that a policy has not finished yet."""
        return np.flatnonzero(~self._finished[policy]).tolist()

    def rows(self, policy: str) -> Rows:
        """A policy's rows so far, by task."""
        return Rows(self._packed.get(policy, []))

    def write(
        self,
        rows: Mapping[str, Iterable[Row]],
        summary: dict[str, Any],
        *,
        complete: bool = True,
    ) -> None:
        """Writes ``episodes.csv`` and ``summary.json``; a complete run needs no shards any more.

        Args:
            rows: Rows by policy.
            summary: The summary.
            complete: Whether the run is finished.
        """
        if self.folder is None:
            return
        write_results(self.folder, rows, summary)
        if complete:
            self._journal.remove()


def write_results(folder: Path, rows: Mapping[str, Iterable[Row]], summary: dict[str, Any]) -> None:
    """Writes ``episodes.csv`` and ``summary.json``."""
    with atomic_writer(folder / "episodes.csv") as file:
        writer = csv.DictWriter(file, fieldnames=COLUMNS, lineterminator="\n")
        writer.writeheader()
        for own in rows.values():
            writer.writerows(own)
    write_atomically(folder / "summary.json", json.dumps(summary, indent=2) + "\n")


def new_folder(folder: Path, *, overwrite: bool) -> None:
    """Makes a folder for results, or an existing one free of them.

    Raises:
        InvalidInputError: It can't be written, or holds results that may not go.
    """
    writable_folder(folder)
    _clear(folder, overwrite)


def _clear(folder: Path, overwrite: bool) -> None:
    if any(folder.iterdir()) and not overwrite:
        raise InvalidInputError(
            "out", str(folder), "an empty folder (or --overwrite, or --resume to go on)"
        )
    for pattern in _STALE:
        for stale in folder.glob(pattern):
            stale.unlink()
