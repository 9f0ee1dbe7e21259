"""``python -m evaluate solve``: what it makes, refuses and survives."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from evaluate.__main__ import main
from evaluate.plans import COLUMNS, Problem, replay, solve
from harness.engine import Engine
from snake_env.sim.tasks import load_tasks
from tests.support.commands import QUICK, Command, Interrupted, names, read_csv, tree
from tests.support.robots import PAPER

EVALUATE = Command(main)
SOLVE = ("solve", "--tasks", "random:4:5", "--budget", "1500", "--workers", "1", "--out")
BAD = {
    "solve --budgte 5": r"--budget",
    "solve --budget": r"--budget",
    "solve --budget many": r"'many'",
    "solve extra": r"extra",
    "solve --budget 0": r"^budget = 0: expected a positive number of roll-outs$",
    "solve --tasks random:0": r"^tasks = 'random:0': expected random:N",
    "solve --tasks paper-50": r"^unknown task suite 'paper-50': did you mean 'paper-500'\?",
    "solve --preset papr": r"^unknown preset 'papr': did you mean 'paper'\?",
    "solve --set a_cc=1": r"^unknown parameter 'a_cc': did you mean 'a_c'\?",
    "solve --set n_joints=4": r"^n_joints = 4: expected an integer from 5 to 16$",
    "solve --workers 0": r"^workers = 0: expected a positive number, or -1",
    "solve --engine rays": r"rays",
    "solve --overwrite --resume": r"^overwrite = True: expected one of --overwrite and --resume$",
    "solve --tasks random:2 --improve {tmp}/none.csv": r"none\.csv.*No such file",
    "solve --tasks random:2 --improve {tmp}": r"^improve = .*Is a directory",
}


def test_help__names_its_options(capsys: pytest.CaptureFixture[str]) -> None:
    assert EVALUATE.run("solve", "--help") == 0
    text = capsys.readouterr().out
    assert "usage: python -m evaluate solve" in text
    for option in ("--out DIR", "--set NAME=VALUE", "--preset STR", "--workers INT"):
        assert option in text


@pytest.mark.parametrize("case", BAD)
def test_bad_input__is_refused_in_one_line_and_nothing_is_written(
    case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command, *words = case.format(tmp=tmp_path).split()
    told = EVALUATE.refusal(capsys, command, "--out", tmp_path / "out", *words)
    assert re.search(BAD[case], told)
    assert tree(tmp_path) == {}


def test_process__records_its_command(tmp_path: Path) -> None:
    search = ("solve", "--tasks", "random:2:1", "--budget", 300, *QUICK)
    done = EVALUATE.process(*search, "--out", tmp_path / "out", COLUMNS="40")
    assert f"of 2 tasks solved: {tmp_path}/out/plans.csv\n" in done.stdout
    assert names(tmp_path / "out") == {"plans.csv", "search.json"}
    about = json.loads((tmp_path / "out" / "search.json").read_text())
    assert about["command"].startswith("python -m evaluate solve --tasks random:2:1 --budget 300")


def _plans(folder: Path) -> list[dict[str, str]]:
    return read_csv(folder / "plans.csv")


@pytest.fixture(scope="module")
def solved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The plans of an uninterrupted search."""
    folder = tmp_path_factory.mktemp("solved") / "new" / "plans"
    EVALUATE.good(*SOLVE, folder)
    return folder


def test_solve__writes_a_plan_for_every_task(solved: Path) -> None:
    rows = _plans(solved)
    assert [row["task"] for row in rows] == ["0", "1", "2", "3"]
    suite = load_tasks("random:4:5", PAPER)
    for task, row in enumerate(rows):
        assert tuple(row) == COLUMNS
        plan = replay(suite.initial(task, PAPER), tuple(map(int, row["modes"].split())), PAPER)
        assert plan is not None
        assert (len(plan), float(row["time_s"])) == (int(row["intervals"]), 3.0 * len(plan))
        assert plan.cost == pytest.approx(float(row["cost"]), abs=1e-6)
        problem = Problem(task, suite.initial(task, PAPER), (), 1500, PAPER)
        assert {key: str(value) for key, value in solve(problem).items()} == row


def test_solve__tells_what_it_found(solved: Path, tmp_path: Path, capsys: Any) -> None:
    capsys.readouterr()
    EVALUATE.good(*SOLVE, tmp_path)
    mean = np.mean([float(row["time_s"]) for row in _plans(solved)])
    expected = f"4 of 4 tasks solved, {mean:.2f} s on average: {tmp_path / 'plans.csv'}\n"
    assert capsys.readouterr().out == expected
    EVALUATE.good(
        "solve", "--tasks", "random:2:5", "--budget", "1", *QUICK, "--out", tmp_path / "hard"
    )
    told = capsys.readouterr().out.splitlines()
    assert told[0] == f"0 of 2 tasks solved: {tmp_path / 'hard' / 'plans.csv'}"
    assert told[1:] == [f"task {task}: no plan in 5 roll-outs" for task in range(2)]


@pytest.mark.parametrize("after", [0, 1, 3])
def test_solve__that_is_interrupted_keeps_its_plans_and_resumes(
    after: int, solved: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    EVALUATE.interrupt(after, *SOLVE, tmp_path)
    stdout, stderr = capsys.readouterr()
    assert f"{after} of 4 tasks are kept in {tmp_path}\n" in stdout
    assert stderr == "interrupted\n"
    assert names(tmp_path) == {"plans.partial.jsonl"}
    assert (tmp_path / "plans.partial.jsonl").read_bytes().count(b"\n") == 1 + after
    with pytest.MonkeyPatch.context() as patch:
        engine = Interrupted(4 - after)  # what is left is all that is done
        patch.setattr(Engine, "map", engine)
        EVALUATE.good(*SOLVE, tmp_path, "--resume")
        assert engine.left == 0
    assert (tmp_path / "plans.csv").read_bytes() == (solved / "plans.csv").read_bytes()
    assert names(tmp_path) == {"plans.csv", "search.json"}


@pytest.mark.parametrize(
    "changes",
    [("--budget", "1600"), ("--tasks", "random:4:6"), ("--tasks", "random:5:5"),
     ("--preset", "narrow"), ("--set", "a_c=70", "--transfer"), ("--improve", "{solved}/plans.csv")],
)  # fmt: skip
def test_solve__resumes_the_same_search_only(
    changes: tuple[str, str], solved: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    EVALUATE.interrupt(1, *SOLVE, tmp_path)
    before = tree(tmp_path)
    given = [text.replace("{solved}", str(solved)) for text in changes]
    told = EVALUATE.refusal(capsys, *SOLVE, tmp_path, *given, "--resume")
    assert re.search(r"^resume = .*: expected work with the same policies, tasks, options", told)
    assert tree(tmp_path) == before


def test_solve__keeps_plans_unless_told_otherwise(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    quick = ("solve", "--tasks", "random:2:5", *QUICK, "--out", tmp_path, "--budget")
    EVALUATE.good(*quick, 5)
    before = tree(tmp_path)
    told = EVALUATE.refusal(capsys, *quick, 6)
    assert re.search(r"^out = .*: expected an empty folder \(or --overwrite", told)
    assert tree(tmp_path) == before
    EVALUATE.good(*quick, 9, "--overwrite")
    assert [row["rollouts"] for row in _plans(tmp_path)] == ["10", "10"]
    EVALUATE.interrupt(1, *quick, 5, "--overwrite")
    before = tree(tmp_path)
    assert "--resume" in EVALUATE.refusal(capsys, *quick, 5)
    assert tree(tmp_path) == before
    EVALUATE.good(*quick, 5, "--resume")
    assert [row["rollouts"] for row in _plans(tmp_path)] == ["5", "5"]


def test_solve__begins_with_the_plans_of_another_search(solved: Path, tmp_path: Path) -> None:
    EVALUATE.good(*SOLVE, tmp_path / "more", "--improve", solved / "plans.csv", "--budget", 1)
    for old, new in zip(_plans(solved), _plans(tmp_path / "more"), strict=True):
        assert {**old, "rollouts": "99", "width": "0"} == new
    EVALUATE.good(*SOLVE, tmp_path / "best", "--improve", solved / "plans.csv", "--budget", 6000)
    for old, new in zip(_plans(solved), _plans(tmp_path / "best"), strict=True):
        one, other = ((int(row["intervals"]), float(row["cost"])) for row in (old, new))
        assert other <= one


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("task,modes\n0,1 x 3\n", "invalid literal"),
        ("task,modes\nzero,1 3\n", "invalid literal"),
        ("task,modes\n4,1 2\n", "there is no task 4"),
        ("task,modes\n-1,1 2\n", "there is no task -1"),
        ("task,cost\n0,1\n", "'modes'"),
        ("modes\n0 1\n", "'task'"),
        ("\x00\udcff", "utf-8"),
        ('task,modes\n0,"' + "1 " * 100_000, "field"),
    ],
)
def test_solve__refuses_plans_that_are_none(
    text: str, reason: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "a.csv"
    path.write_text(text, errors="surrogateescape")
    told = EVALUATE.refusal(capsys, *SOLVE, tmp_path / "out", "--improve", path)
    assert told.startswith("improve = ")
    assert "expected the plans.csv of a search of these tasks" in told
    assert reason in told
    assert names(tmp_path) == {"a.csv"}


@pytest.mark.parametrize("modes", ["", "0 1 2", "98 98", "500", "-1", "0"])
def test_solve__does_without_plans_that_lead_nowhere(
    modes: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a.csv").write_text(f"task,modes\n0,{modes}\n1\n")
    quick = ("solve", "--tasks", "random:2:5", *QUICK, "--budget", 5, "--out")
    EVALUATE.good(*quick, tmp_path / "out", "--improve", tmp_path / "a.csv")
    EVALUATE.good(*quick, tmp_path / "without")
    assert _plans(tmp_path / "out") == _plans(tmp_path / "without")
