"""How commands end: without streams, without memory, on a full disk, without a reader."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from snake_env.system.exit_code import exit_code
from tests.support import ROOT
from tests.support.commands import names


def _shell(line: str, folder: Path) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    words = ["sh", "-c", line.replace("PYTHON ", f"{sys.executable} ")]
    return subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True)


@pytest.mark.parametrize(
    ("closed", "more"),
    [
        (">&-", "--no-pictures"),
        ("<&-", "--no-pictures"),
        ("2>&-", "--no-pictures"),
        ("<&- >&- 2>&-", ""),
    ],
)
def test_closed_streams__are_done_without(tmp_path: Path, closed: str, more: str) -> None:
    line = "PYTHON -m evaluate random --tasks random:2 --no-latency --out out --workers 1"
    done = _shell(f"{line} {more} {closed}", tmp_path)
    assert done.returncode == 0, done.stderr
    assert all(line.startswith("compiling") for line in done.stderr.splitlines())
    assert {"episodes.csv", "summary.json"} <= names(tmp_path / "out")
    assert ("report.html" in names(tmp_path / "out")) == (not more)


@pytest.mark.parametrize("command", ["evaluate no-such", "train no-such", "train --help"])
def test_closed_stdout__leaves_the_exit_code_alone(tmp_path: Path, command: str) -> None:
    done = _shell(f"PYTHON -m {command} >&-", tmp_path)
    assert done.returncode == (0 if "help" in command else 2)
    assert done.stderr.count("\n") == (0 if "help" in command else 1)


def test_letters_that_the_terminal_lacks__are_escaped(tmp_path: Path) -> None:
    line = "LC_ALL=C PYTHONIOENCODING=ascii PYTHON -m evaluate 'naïve.safetensors'"
    done = _shell(line, tmp_path)
    assert done.returncode == 2
    assert "na\\xefve" in done.stderr


def test_lack_of_memory__is_one_line(capsys: Any) -> None:
    def command() -> int:
        raise MemoryError("Unable to allocate 3.6 TiB")

    assert exit_code(command) == 1
    assert capsys.readouterr().err == (
        "error: out of memory (Unable to allocate 3.6 TiB): use fewer workers or smaller batches\n"
    )
