"""The figures of a run while it learns: ``log.csv``, and TensorBoard's."""

from __future__ import annotations

from typing import Any

from torch.utils.tensorboard import SummaryWriter

from train.run import RunFolder
from train.validation import quality


class RunLog:
    """What a run of PPO or DQN writes down.

    Attributes:
        rows: Those of ``log.csv``.

    Args:
        folder: The run's.
        name: The learner's.
        done: Decisions up to the checkpoint; what was logged after it will be logged again.
    """

    def __init__(self, folder: RunFolder, name: str, done: int) -> None:
        self._folder, self._name = folder, name
        self.rows: list[dict[str, Any]] = [
            row for row in folder.rows("timesteps") if int(row["timesteps"]) <= done
        ]
        board = folder.path / "tensorboard"
        self._board = SummaryWriter(str(board), purge_step=done + 1 if done else None)

    def note(self, decisions: int, figures: dict[str, Any]) -> None:
        """Adds the figures of an update, of a segment, or of a validation."""
        if not self.rows or int(self.rows[-1]["timesteps"]) < decisions:
            self.rows.append({"timesteps": decisions})
        self.rows[-1] |= {name: round(value, 6) for name, value in figures.items()}
        for name, value in figures.items():
            self._board.add_scalar(f"{self._name}/{name}", float(value), decisions)

    def is_best(self) -> bool:
        """Whether the newest validation is better than those before."""
        *before, newest = [row for row in self.rows if row.get("raw_success", "") != ""]
        return all(quality(newest) > quality(row) for row in before)

    def write(self) -> None:
        """Writes what there is so far: what a checkpoint holds has been logged as well."""
        columns = list(dict.fromkeys(key for row in self.rows for key in row))
        rows = [{key: row.get(key, "") for key in columns} for row in self.rows]
        self._folder.write_rows(rows)
        self._board.flush()

    def close(self) -> None:
        """Closes TensorBoard's file."""
        self._board.close()
