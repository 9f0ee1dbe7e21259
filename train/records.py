"""What a run has written about itself, read back: ``run.json`` and ``log.csv``."""

from __future__ import annotations

import csv
import io
import itertools
from pathlib import Path
from typing import Any

from harness.files import FileError, read_json, read_text
from snake_env.errors import InvalidInputError, SnakeEnvError
from snake_env.params import SnakeParams

ABOUT = "run.json"
SCHEMA = 1


def read_about(folder: Path, field: str) -> dict[str, Any]:
    """What ``run.json`` says of a run.

    Args:
        folder: The run's folder.
        field: What an error calls it.

    Raises:
        InvalidInputError: There is none, or it is damaged.
    """
    try:
        about = read_json(folder / ABOUT)
    except FileError as error:
        expected = f"the folder of a run of train ({ABOUT}: {error})"
        raise InvalidInputError(field, str(folder), expected) from None
    if not isinstance(about, dict) or about.get("schema") != SCHEMA:
        raise InvalidInputError(field, str(folder), f"a run of schema {SCHEMA}")
    kinds = {"algorithm": str, "robot": str, "command": str, "config": dict, "versions": dict}
    try:
        if not all(isinstance(about[name], kind) for name, kind in kinds.items()):
            raise ValueError(f"{', '.join(kinds)} are needed")
        if not isinstance(about["git"], str | None):
            raise ValueError(f"git is {about['git']!r}")
        SnakeParams().replace(**about["config"]["params"])
    except (ValueError, TypeError, LookupError, SnakeEnvError) as error:
        expected = f"an undamaged run ({ABOUT}: {error})"
        raise InvalidInputError(field, str(folder), expected) from None
    return about


def read_log(path: Path, counter: str | None = None) -> list[dict[str, str]]:
    """The rows of a run's ``log.csv``: numbers, or nothing.

    Args:
        path: The file.
        counter: The column that says how far the run was, which grows; None: it does not matter.

    Raises:
        InvalidInputError: It is damaged.
    """
    try:
        reader = csv.DictReader(io.StringIO(read_text(path)), strict=True)
        rows: list[dict[str, str]] = list(reader)
        counts = [] if counter is None else [int(row[counter]) for row in rows]
        if any(after <= before for before, after in itertools.pairwise([0, *counts])):
            raise ValueError(f"{counter} does not grow")
        for row in rows:
            for name, text in row.items():
                if text:
                    float(text)
                elif text is None or name is None:
                    raise ValueError("a torn row")
    except (ValueError, TypeError, LookupError, csv.Error) as error:
        expected = f"the undamaged log of a run ({error})"
        raise InvalidInputError("log", str(path), expected) from None
    return rows
