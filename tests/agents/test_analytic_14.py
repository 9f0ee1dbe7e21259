"""``python -m agents.analytic_14``: the candidates of the policy, counted from episodes."""

import json
from collections import Counter
from pathlib import Path

import pytest

from agents.analytic_14 import choices
from snake_env.modes import mode_table
from snake_env.sim.tasks import random_suite
from tests.support import ROOT
from tests.support.commands import python
from tests.support.robots import PAPER, run_episode, sim_1_episode, straight_state

COMMITTED = ROOT / "snake_env" / "policies" / "analytic_14.json"


def _run(out: Path, tasks: str, size: int) -> dict[str, object]:
    before = COMMITTED.read_bytes()
    options = ("--tasks", tasks, "--size", size, "--workers", 2, "--out", out)
    python("-m", "agents.analytic_14", *options)
    assert COMMITTED.read_bytes() == before
    return json.loads(out.read_text())


def test_choices__are_the_modes_of_the_episode() -> None:
    states, modes, _ = sim_1_episode()
    expected = Counter((state.phase, mode) for state, mode in zip(states, modes, strict=False))
    assert choices(states[0], PAPER) == expected
    assert sum(choices(straight_state(), PAPER).values()) == 8
    assert choices(straight_state().replace(phase=9), PAPER) == Counter()


def test_command__keeps_the_most_frequent_modes_of_each_phase(tmp_path: Path) -> None:
    written = _run(tmp_path / "table.json", "random:6:2", 5)
    committed = json.loads(COMMITTED.read_text())
    assert written.keys() == committed.keys() == {"command", "modes"}
    assert written["command"] == "python -m agents.analytic_14 --tasks random:6:2 --size 5"
    counts: Counter[tuple[int, int]] = Counter()
    suite = random_suite(6, 2, PAPER)
    for task in range(6):
        states, modes, _ = run_episode(suite.initial(task, PAPER), PAPER)
        counts.update((state.phase, mode) for state, mode in zip(states, modes, strict=False))
    assert list(written["modes"]) == [str(phase) for phase in range(1, 9)]
    for phase in range(1, 9):
        valid = mode_table(8).valid(phase).tolist()
        ranked = sorted(valid, key=lambda mode: -counts[phase, mode])
        assert written["modes"][str(phase)] == sorted(ranked[:5])


def test_committed_table__names_the_command_that_made_it() -> None:
    table = json.loads(COMMITTED.read_text())
    assert table["command"] == "python -m agents.analytic_14 --tasks random:2000:14 --size 14"
    for phase, modes in table["modes"].items():
        assert modes == sorted(modes)
        assert len(modes) == min(14, len(mode_table(8).valid(int(phase))))


@pytest.mark.slow
def test_committed_table__is_what_its_command_makes(tmp_path: Path) -> None:
    written = _run(tmp_path / "table.json", "random:2000:14", 14)
    assert written == json.loads(COMMITTED.read_text())
