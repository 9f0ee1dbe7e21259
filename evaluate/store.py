"""The result folder: finished shards as they come, then ``episodes.csv`` and ``summary.json``.

Every shard is appended to ``episodes.partial.jsonl`` as one line when it is done. A killed run leaves
at worst one torn last line there, which is dropped when the run is resumed.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from evaluate.journal import Journal, writable_folder, write_atomically
from evaluate.protocol import COLUMNS, Row, ShardResult
from snake_env.errors import InvalidInputError

Key = tuple[str, int]
"""A shard: its policy and its first task."""


class Store:
    """Results of a run, in memory and (if there is a folder) on disk.

    Args:
        folder: Where results go; None: nowhere.
        config: What decides the results; a resumed run must have the same.
        overwrite: Whether results that are there already may go.
        resume: Whether to go on with an interrupted run.

    Raises:
        InvalidInputError: The folder can't be written, holds results, or a run with another config.
    """

    def __init__(
        self, folder: Path | None, config: dict[str, Any], *, overwrite: bool, resume: bool
    ) -> None:
        self.folder = folder
        self.results: dict[Key, ShardResult] = {}
        if folder is None:
            return
        path = folder / "episodes.partial.jsonl"
        if resume and not path.is_file():
            raise InvalidInputError("resume", str(folder), "a folder with an interrupted run")
        writable_folder(folder)
        if not resume:
            if any(folder.iterdir()) and not overwrite:
                raise InvalidInputError(
                    "out", str(folder), "an empty folder (or --overwrite, or --resume to go on)"
                )
            for pattern in (
                "episodes.csv",
                "summary.json",
                "report.html",
                "video-*.*",
                "fig4-*.png",
                "sim-1-*.png",
            ):
                for stale in folder.glob(pattern):
                    stale.unlink()
        self._journal = Journal(path, config, resume=resume)
        for entry in self._journal.entries:
            policy, first = entry["key"]
            self.results[policy, first] = ShardResult(entry["rows"], entry["latencies_us"])

    def add(self, key: Key, result: ShardResult) -> None:
        """Takes a finished shard."""
        self.results[key] = result
        if self.folder is not None:
            latencies = [round(value, 1) for value in result.latencies_us]
            self._journal.append({"key": key, "rows": result.rows, "latencies_us": latencies})

    def rows(self, policy: str) -> list[Row]:
        """A policy's rows so far, by task."""
        keys = sorted(key for key in self.results if key[0] == policy)
        return [row for key in keys for row in self.results[key].rows]

    def latencies(self, policy: str) -> list[float]:
        """Durations of a policy's decisions so far [us]."""
        keys = sorted(key for key in self.results if key[0] == policy)
        return [value for key in keys for value in self.results[key].latencies_us]

    def write(self, policies: Iterable[str], summary: dict[str, Any], *, complete: bool) -> None:
        """Writes ``episodes.csv`` and ``summary.json``; a complete run needs no shards any more."""
        if self.folder is None:
            return
        rows = [row for policy in policies for row in self.rows(policy)]
        text = io.StringIO()
        writer = csv.DictWriter(
            text, fieldnames=list(rows[0]) if rows else COLUMNS, lineterminator="\n"
        )
        writer.writeheader()
        writer.writerows(rows)
        write_atomically(self.folder / "episodes.csv", text.getvalue())
        write_atomically(self.folder / "summary.json", json.dumps(summary, indent=2) + "\n")
        if complete:
            self._journal.remove()
