"""``python -m snake_env``."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from PIL import Image

from snake_env.__main__ import main
from tests.support import ROOT
from tests.support.commands import Command, python


def test_check__finds_this_installation_well(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check"]) == 0
    assert capsys.readouterr().out.rstrip().endswith("all checks passed")


def test_gif__shows_the_episode(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "snake.gif"
    arguments = ["gif", "--policy", "random", "--tasks", "random:3", "--task", "1"]
    assert main([*arguments, "--out", str(path)]) == 0
    assert str(path) in capsys.readouterr().out
    with Image.open(path) as image:
        assert image.n_frames > 5


def play(lines: list[str], monkeypatch: pytest.MonkeyPatch) -> int:
    answers = iter(lines)

    def answer(_: str) -> str:
        try:
            return next(answers)
        except StopIteration:
            raise EOFError from None

    monkeypatch.setattr("builtins.input", answer)
    return main(["play"])


def test_play__takes_modes_wheels_and_advice(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert play(["a", "l", "85", "1", "2 up", "x", "5 7 up", "q"], monkeypatch) == 0
    out = capsys.readouterr().out
    assert "mode 85: lifts 3, 4, 5, 7" in out
    assert "88 of 99 modes are feasible" in out
    assert "mode 85: wheels 1, 3, 4, 5, 7 in the air" in out
    assert out.count("valid in phase 2") == 2  # mode 1 and "2 up" are the same
    assert "a number; ? for help" in out
    assert "wheels 2, 5, 7 in the air" in out


def test_play__ends_with_the_input(monkeypatch: pytest.MonkeyPatch) -> None:
    assert play(["85"], monkeypatch) == 0


@pytest.mark.parametrize(
    ("arguments", "hint"),
    [
        (["gif", "--policy", "analytc"], "did you mean 'analytic'"),
        (["gif", "--preset", "papr"], "did you mean 'paper'"),
        (["gif", "--task", "1"], "task = 1: expected a row from 0 to 0"),
        (["gif", "--out", "/nowhere/x.gif"], "a folder that exists"),
        (["play", "--tasks", "sim1"], "did you mean 'sim-1'"),
    ],
)
def test_bad_input__is_one_line(
    arguments: list[str], hint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert hint in Command(main).refusal(capsys, *arguments)


def test_reader_that_goes__ends_the_command_quietly() -> None:
    words = [sys.executable, "-m", "snake_env", "check"]
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(words, cwd=ROOT, stdout=writer, stderr=subprocess.PIPE, text=True)
    os.close(writer)
    assert (done.returncode, done.stderr) == (141, "")


@pytest.mark.parametrize("command", ["snake_env", "evaluate", "train"])
def test_version__is_told_by_every_command(command: str) -> None:
    done = python("-m", command, "--version")
    assert (done.stdout, done.stderr) == ("snake-mode-env 0.1.0\n", "")


@pytest.mark.parametrize("words", [["check"], ["play"]])
def test_full_disk_behind_stdout__is_told_in_one_line(words: list[str]) -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "snake_env", *words],
            cwd=ROOT, stdin=subprocess.DEVNULL, stdout=full, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
    assert done.returncode == 1
    assert done.stderr == "error: [Errno 28] No space left on device\n"


def test_play__without_standard_streams_ends_quietly() -> None:
    command = f"{sys.executable} -m snake_env play <&- >&-"
    done = subprocess.run(["sh", "-c", command], cwd=ROOT, stderr=subprocess.PIPE, text=True)
    assert (done.returncode, done.stderr) == (0, "")
