"""The journal of finished work."""

from pathlib import Path

import pytest

from harness.journal import Journal
from snake_env.errors import InvalidInputError

CONFIG = {"policies": ["random"]}


@pytest.mark.parametrize("header", ["", "{}\n", "null\n", "\0" * 99, "[" * 100_000])
def test_odd_beginning_of_a_journal__is_refused(tmp_path: Path, header: str) -> None:
    path = tmp_path / "work.jsonl"
    path.write_text(header)
    with pytest.raises(InvalidInputError, match="the same policies, tasks"):
        Journal(path, CONFIG, resume=True, take=print)
