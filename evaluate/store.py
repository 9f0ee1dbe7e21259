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

from evaluate.protocol import COLUMNS, Row
from evaluate.rows import Rows, pack
from harness.folder import Layout
from harness.journal import Journal
from snake_env.system.files import atomic_writer, write_atomically

PARTIAL = "episodes.partial.jsonl"
LAYOUT = Layout(
    begun=PARTIAL,
    done="summary.json",
    own=("episodes.csv", "report.html", "fig4-*.png", "sim-1-*.png", "video-*.*"),
)
"""What a folder of results holds."""


class Store:
    """Results of a run, in memory and (if there is a folder) on disk.

    Args:
        folder: Where results go, held by this process; None: nowhere.
        config: What decides the results; a resumed run must have the same. Its ``policies`` name the
            policies, its ``tasks`` the number ``n`` of tasks.
        resume: Whether to continue the interrupted run in the folder.

    Attributes:
        done: How many episodes are finished.

    Raises:
        InvalidInputError: The folder holds a run with another config, or a damaged one.
    """

    def __init__(self, folder: Path | None, config: dict[str, Any], *, resume: bool) -> None:
        self.folder = folder
        self.done = 0
        self._packed: dict[str, list[NDArray[np.void]]] = {}
        self._finished: dict[str, NDArray[np.bool_]] = {
            policy: np.zeros(config["tasks"]["n"], dtype=np.bool_) for policy in config["policies"]
        }
        if folder is not None:
            self._journal = Journal(
                folder / PARTIAL,
                config,
                resume=resume,
                take=lambda entry: self._take(entry["rows"]),
            )

    def add(self, rows: list[Row]) -> None:
        """Takes a finished shard."""
        self._take(rows)
        if self.folder is not None:
            self._journal.append({"rows": rows})

    def _take(self, rows: list[Row]) -> None:
        """Takes the rows of a shard; of a task that is there already the first row counts."""
        packed = pack(rows)
        policies = set(packed["policy"])
        if len(policies) != 1 or np.any(packed["task"] < 0):
            raise ValueError("a shard is episodes of one policy")
        policy = policies.pop()
        finished = self._finished[policy]
        new = ~finished[packed["task"]]
        _, first = np.unique(packed["task"], return_index=True)
        packed = packed[np.intersect1d(first, np.flatnonzero(new))]
        finished[packed["task"]] = True
        self._packed.setdefault(policy, []).append(packed)
        self.done += len(packed)

    def missing(self, policy: str) -> list[int]:
        """The tasks that a policy has not finished yet."""
        return np.flatnonzero(~self._finished[policy]).tolist()

    def rows(self, policy: str) -> Rows:
        """A policy's rows so far, by task."""
        return Rows(self._packed.get(policy, []))

    def write(self, rows: Mapping[str, Iterable[Row]], summary: dict[str, Any]) -> None:
        """Writes ``episodes.csv`` and ``summary.json``.

        Args:
            rows: Rows by policy.
            summary: The summary.
        """
        if self.folder is not None:
            write_results(self.folder, rows, summary)

    def finish(self) -> None:
        """Removes the finished shards: everything that comes of them is written."""
        if self.folder is not None:
            self._journal.remove()


def write_results(folder: Path, rows: Mapping[str, Iterable[Row]], summary: dict[str, Any]) -> None:
    """Writes ``episodes.csv`` and ``summary.json``."""
    with atomic_writer(folder / "episodes.csv") as file:
        writer = csv.DictWriter(file, fieldnames=COLUMNS, lineterminator="\n")
        writer.writeheader()
        for own in rows.values():
            writer.writerows(own)
    write_atomically(folder / "summary.json", json.dumps(summary, indent=2) + "\n")
