"""The comparison of imitation's options: what it learns from, what it asks, what it prints."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from agents import imitation_study
from agents.imitate import Lessons
from agents.imitation_study import Options, held_out, main, split
from evaluate.engine import Engine
from snake_env.errors import InvalidInputError
from snake_env.network import Network
from snake_env.observation import observation_size

SIZE = observation_size(6)


def _run(folder: Path, count: int = 220) -> Path:
    rng = np.random.default_rng(1)
    for k in range(2):
        cost = rng.uniform(3.0, 9.0, (count, 16)).astype(np.float16)
        cost[:, 5] = np.inf
        observations = rng.normal(size=(count, SIZE)).astype(np.float32)
        observations[:, 0] = np.arange(count) + k * count
        np.savez(folder / f"lessons-{k}.npz", observations=observations, cost=cost)
    return folder


def test_held_out__is_the_share_of_infeasible_choices_and_the_regret_of_the_others() -> None:
    cost = np.array([[4.0, 3.0, -1.0], [np.inf, 2.0, 9.0], [5.0, 7.5, 6.0], [1.0, 1.0, np.inf]])
    wanted = np.array([[1, 0, 9], [3, 2, 1], [0, 2, 1], [2, 1, 0]])  # mode 0, 0 (broken), 1, 0
    network = Network([np.eye(3, dtype=np.float32)], [np.zeros(3, dtype=np.float32)])
    given = Lessons(wanted.astype(np.float32), cost.astype(np.float16))
    infeasible, regret = held_out(network, given)
    assert infeasible == 25.0
    assert regret == pytest.approx((1.0 + 2.5 + 0.0) / 3)


def test_split__keeps_a_tenth_that_nobody_learns_from(tmp_path: Path) -> None:
    learned, other = split(_run(tmp_path), 300)
    assert (len(learned.cost), len(other.cost)) == (300, 30)
    assert not set(learned.observations[:, 0]) & set(other.observations[:, 0])
    learned, other = split(tmp_path, 10_000)
    assert (len(learned.cost), len(other.cost)) == (400, 40)


def test_split__needs_judgements(tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError, match="a run of train imitate"):
        split(tmp_path, 100)


def test_study__prints_a_line_for_every_choice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    small = {"hidden": (8,), "last_epochs": 1}
    choices = {"small": [small], "batch_size": [{**small, "batch_size": 64}]}
    monkeypatch.setattr(imitation_study, "CHOICES", choices)
    main(Options(Engine(workers=1), _run(tmp_path), decisions=200, seeds=2))
    printed = capsys.readouterr().out
    assert "200 judgements to learn from, 20 held out" in printed
    for name in choices:
        (line,) = (line for line in printed.splitlines() if line.startswith(f" {name} "))
        assert line.count("+-") == 2


def test_command__finds_its_functions_in_other_processes(tmp_path: Path) -> None:
    words = ["--lessons", str(_run(tmp_path)), "--seeds", "1", "--workers", "2"]
    command = [sys.executable, "-m", "agents.imitation_study", *words]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    assert "400 judgements to learn from" in done.stdout
    for name in imitation_study.CHOICES:
        assert f" {name} " in done.stdout
