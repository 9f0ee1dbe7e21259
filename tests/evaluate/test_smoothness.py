"""How much the joint input jumps where modes and phases are switched."""

import pytest

from evaluate.smoothness import input_changes, main
from snake_env.sim.tasks import load_tasks
from tests.support.robots import PAPER


def test_sim_1__has_the_changes_of_the_tenth_deviation() -> None:
    changes = input_changes("analytic", load_tasks("sim-1", PAPER).initial(0, PAPER), PAPER, 0)
    assert (round(changes.at_phase, 3), round(changes.inside, 3)) == (0.141, 0.117)
    assert changes.at_mode < changes.inside / 3


def test_command__prints_them(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["smoothness", "--tasks", "sim-1"])
    assert main() == 0
    printed = capsys.readouterr().out
    assert "phase shifted     max 0.1407" in printed
    assert "inside intervals  max 0.1171" in printed
    assert printed.rstrip().endswith(": 1")
