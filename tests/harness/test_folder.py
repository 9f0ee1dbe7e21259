"""Folders of results: held by one process, resumed whatever is there, cleared only of what is known."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from evaluate.__main__ import main as evaluate
from harness.folder import Layout, held
from snake_env.errors import InvalidInputError
from tests.support import ROOT
from tests.support.commands import Command, names, wait_until
from train.__main__ import main as train

LAYOUT = Layout(begun="work.jsonl", done="done.json", own=("*.png", "board"))
HOLD = """
import sys, time
from pathlib import Path
from harness.folder import Layout, held
with held(Path(sys.argv[1]), Layout("work.jsonl", "done.json", ())):
    print("held", flush=True)
    time.sleep(60)
"""


def _fill(folder: Path, *files: str) -> None:
    for name in files:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("x")


@pytest.mark.parametrize(
    ("files", "found"),
    [
        ((), "nothing"),
        (("done.json",), "finished"),
        (("done.json", "work.jsonl"), "begun"),
        (("work.jsonl", "a.png"), "begun"),
        ((".snake-env-ab12_9xz.tmp",), "nothing"),
    ],
)
def test_resume__goes_by_what_is_there(tmp_path: Path, files: tuple[str, ...], found: str) -> None:
    _fill(tmp_path, *files)
    with held(tmp_path, LAYOUT, resume=True) as there:
        assert there == found
        assert names(tmp_path) == {name for name in files if name[0] != "."}


@pytest.mark.parametrize("options", [{}, {"resume": True}, {"overwrite": True}])
def test_foreign_folder__is_left_alone(tmp_path: Path, options: dict[str, bool]) -> None:
    files = {"notes.txt", "a.png", "tmpab12_9xz", ".snake-env-ab12_9xz.tmp"}
    _fill(tmp_path, *files)
    with (
        pytest.raises(InvalidInputError, match="an empty folder, or one with a run"),
        held(tmp_path, LAYOUT, **options),
    ):
        pass
    assert names(tmp_path) == files


def test_results__are_refused_or_replaced(tmp_path: Path) -> None:
    _fill(tmp_path, "done.json", "a.png", "notes.txt", "board/events")
    with pytest.raises(InvalidInputError, match="--overwrite"), held(tmp_path, LAYOUT):
        pass
    with held(tmp_path, LAYOUT, overwrite=True) as found:
        assert found == "nothing"
        assert names(tmp_path) == {"notes.txt"}


def test_held_folder__lets_no_other_in(tmp_path: Path) -> None:
    for options in ({}, {"resume": True}, {"overwrite": True}):
        with (
            held(tmp_path, LAYOUT),
            pytest.raises(InvalidInputError, match="no other process"),
            held(tmp_path, LAYOUT, **options),
        ):
            pass
    with held(tmp_path, LAYOUT):
        assert names(tmp_path) == set()


def test_lock__dies_with_its_owner(tmp_path: Path) -> None:
    words = [sys.executable, "-c", HOLD, str(tmp_path)]
    owner = subprocess.Popen(words, cwd=ROOT, stdout=subprocess.PIPE, text=True)
    assert owner.stdout is not None
    assert owner.stdout.readline() == "held\n"
    with pytest.raises(InvalidInputError, match="no other process"), held(tmp_path, LAYOUT):
        pass
    os.kill(owner.pid, signal.SIGKILL)
    owner.wait()
    with held(tmp_path, LAYOUT) as found:
        assert found == "nothing"
    owner.stdout.close()


KILLED = """
import os, signal, sys
from pathlib import Path
from snake_env.system import files
with files.replacing(Path(sys.argv[1])) as file:
    file.write(b"half")
    file.flush()
    os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.parametrize("options", [{}, {"resume": True}, {"overwrite": True}])
def test_what_a_killed_writer_leaves__blocks_nothing(
    tmp_path: Path, options: dict[str, bool]
) -> None:
    subprocess.run([sys.executable, "-c", KILLED, str(tmp_path / "done.json")], cwd=ROOT)
    assert len(names(tmp_path)) == 1
    with held(tmp_path, LAYOUT, **options) as found:
        assert found == "nothing"
        assert names(tmp_path) == set()


def test_folder_that_cannot_be_made__is_refused(tmp_path: Path) -> None:
    _fill(tmp_path, "file")
    for folder in (tmp_path / "file", tmp_path / "file" / "below", tmp_path / ("a" * 300)):
        with pytest.raises(InvalidInputError, match="a folder to write to"), held(folder, LAYOUT):
            pass
    with pytest.raises(InvalidInputError, match="a folder to write to"), held(Path("a\0b"), LAYOUT):
        pass


COMMANDS = {
    "evaluate": (
        "analytic --tasks random:3000 --workers 1 --no-pictures --no-latency",
        "--overwrite",
    ),
    "solve": ("solve --tasks random:500 --workers 1 --budget 2000", "--resume"),
    "value": ("value --episodes 4096 --workers 1", "--resume"),
    "dqn": ("dqn --timesteps 1000000", "--overwrite"),
}
MARKS = {"evaluate": "episodes.partial.jsonl", "solve": "plans.partial.jsonl"}


@pytest.mark.parametrize("command", COMMANDS)
def test_second_process__is_refused(tmp_path: Path, command: str) -> None:
    out, package = tmp_path / "out", Command(evaluate if command in MARKS else train)
    arguments, option = COMMANDS[command]
    words = [*arguments.split(), "--out", out]
    first = package.start(*words)
    wait_until((out / MARKS.get(command, "run.json")).exists, first)
    try:
        second = package.process(*words, option, code=2)
        assert second.stdout == ""
        assert "a folder that no other process is writing to" in second.stderr
        assert second.stderr.count("\n") == 1
        assert first.poll() is None
    finally:
        first.kill()
        first.communicate()
