"""The result folder: shards as they come, resuming, atomic files, refusals."""

import json
import math
from pathlib import Path
from typing import Any

import pytest

from evaluate.protocol import COLUMNS, Row
from evaluate.store import LAYOUT, Store
from harness.folder import held
from snake_env.errors import InvalidInputError
from tests.support.commands import names
from tests.support.evaluations import episodes

CONFIG = {"policies": ["b", "a"], "tasks": {"n": 30}, "params": {"l": 0.091}}


def _row(policy: str, task: int, **changes: Any) -> Row:
    row = dict.fromkeys(COLUMNS, 0.1 + task / 3) | {
        "policy": policy, "task": task, "outcome": "success", "intervals": 13, "phase": 9,
        "cost_integral": math.nan, "rollouts": 2**40, "modes": "0 98 12", "error": "",
    }  # fmt: skip
    return row | changes


def _result(policy: str, first: int, **changes: Any) -> list[Row]:
    return [_row(policy, first + k, **changes) for k in range(10)]


def _store(folder: Path, *, resume: bool = False, overwrite: bool = False) -> Store:
    with held(folder, LAYOUT, overwrite=overwrite, resume=resume) as found:
        return Store(folder, CONFIG, resume=found == "begun")


def _written(folder: Path) -> list[tuple[str, int]]:
    return [(row["policy"], int(row["task"])) for row in episodes(folder)]


def _write(store: Store, summary: dict[str, Any], *, complete: bool) -> None:
    store.write({name: store.rows(name) for name in "ba"}, summary)
    if complete:
        store.finish()


def test_results__are_sorted_whatever_the_order_of_arrival(tmp_path: Path) -> None:
    store = _store(tmp_path / "new" / "folder")
    for key in [("a", 20), ("b", 10), ("a", 0), ("b", 0), ("a", 10), ("b", 20)]:
        store.add(_result(*key))
    _write(store, {"policies": {}}, complete=True)
    expected = [(policy, task) for policy in "ba" for task in range(30)]
    assert _written(tmp_path / "new" / "folder") == expected
    assert [row["task"] for row in store.rows("a")] == list(range(30))
    assert store.done == 60


def test_rows__are_what_was_added() -> None:
    store = Store(None, CONFIG, resume=False)
    for first in (10, 0):
        store.add(_result("a", first))
    rows = store.rows("a")
    assert len(rows) == 20
    assert str(list(rows)) == str([_row("a", task) for task in range(20)])  # NaN != NaN
    assert str(rows[-1]) == str(_row("a", 19))
    assert [row["task"] for row in rows[3:5]] == [3, 4]
    assert rows.column("task").tolist() == list(range(20))
    assert {name: type(value) for name, value in rows[0].items()} == {
        name: type(value) for name, value in _row("a", 0).items()
    }
    assert (len(store.rows("b")), list(store.rows("b"))) == (0, [])


def test_missing__are_the_tasks_without_a_result(tmp_path: Path) -> None:
    store = _store(tmp_path)
    store.add(_result("a", 10))
    assert store.missing("a") == [*range(10), *range(20, 30)]
    assert store.missing("b") == list(range(30))


def test_complete_run__leaves_two_files_with_ordinary_rights(tmp_path: Path) -> None:
    store = _store(tmp_path)
    store.add(_result("a", 0))
    assert names(tmp_path) == {"episodes.partial.jsonl"}
    _write(store, {"policies": {"a": 1}}, complete=True)
    assert names(tmp_path) == {"episodes.csv", "summary.json"}
    assert {path.stat().st_mode & 0o777 for path in tmp_path.iterdir()} == {0o644}
    assert json.loads((tmp_path / "summary.json").read_text()) == {"policies": {"a": 1}}


def test_interrupted_run__keeps_its_shards_and_resumes(tmp_path: Path) -> None:
    store = _store(tmp_path)
    store.add(_result("a", 10))
    _write(store, {}, complete=False)
    assert names(tmp_path) == {"episodes.csv", "summary.json", "episodes.partial.jsonl"}
    again = _store(tmp_path, resume=True)
    assert again.done == 10
    again.add(_result("a", 0))
    _write(again, {}, complete=True)
    resumed = (tmp_path / "episodes.csv").read_bytes()

    whole = _store(tmp_path / "whole")
    for first in (0, 10):
        whole.add(_result("a", first))
    _write(whole, {}, complete=True)
    assert (tmp_path / "whole" / "episodes.csv").read_bytes() == resumed


@pytest.mark.parametrize("cut", [1, 2, 40, 10_000])
def test_resume__drops_a_torn_last_line(tmp_path: Path, cut: int) -> None:
    store = _store(tmp_path)
    partial = tmp_path / "episodes.partial.jsonl"
    for first in (0, 10):
        store.add(_result("a", first))
    whole = partial.read_text()
    last = len(whole.splitlines()[-1])
    partial.write_text(whole[: -min(cut, last)])
    again = _store(tmp_path, resume=True)
    kept = 10 if cut > 1 else 20  # 1: only the line's end is missing
    assert again.missing("a") == list(range(kept, 30))
    again.add(_result("a", 20))  # on a line of its own
    assert _store(tmp_path, resume=True).missing("a") == list(range(kept, 20))


FOREIGN = {
    "another piece": {"key": 1},
    "no piece": [1, 2],
    "an empty list": [],
    "a number": 3,
    "a text": "x",
    "no rows": {"rows": 3},
    "rows by name": {"rows": {}},
    "an unknown policy": {"rows": [_row("c", 20)]},
    "a task that is not in the suite": {"rows": [_row("a", 30)]},
    "two policies": {"rows": [_row("a", 20), _row("b", 20)]},
    "other columns": {"rows": [{"policy": "a", "task": 20}]},
    "a text for a number": {"rows": [_row("a", 20, time_s="soon")]},
    "nothing": None,
    "an empty object": {},
    "an unknown outcome": {"rows": [_row("a", 20, outcome="victory")]},
    "no outcome": {"rows": [_row("a", 20, outcome="")]},
    "a negative task": {"rows": [_row("a", -1)]},
    "a task of 10^12": {"rows": [_row("a", 10**12)]},
    "a time before the beginning": {"rows": [_row("a", 20, time_s=-3.0)]},
    "an endless time": {"rows": [_row("a", 20, time_s=math.inf)]},
    "modes that are none": {"rows": [_row("a", 20, modes="1 x")]},
    "a list for a text": {"rows": [_row("a", 20, error=["a"])]},
    "a truth value for a number": {"rows": [_row("a", 20, intervals=True)]},
    "a number that is too large": {"rows": [_row("a", 20, intervals=10**30)]},
}


@pytest.mark.parametrize("entry", FOREIGN.values(), ids=FOREIGN.keys())
def test_resume__refuses_a_damaged_journal_and_keeps_it(tmp_path: Path, entry: Any) -> None:
    _store(tmp_path).add(_result("a", 0))
    partial = tmp_path / "episodes.partial.jsonl"
    with partial.open("a") as file:
        file.write(json.dumps(entry) + "\n")
    before = partial.read_bytes()
    with pytest.raises(InvalidInputError, match=r"line 3 of .*expected a finished piece"):
        _store(tmp_path, resume=True)
    assert partial.read_bytes() == before
    assert names(tmp_path) == {"episodes.partial.jsonl"}


@pytest.mark.parametrize("line", ["[" * 100_000, "9" * 10_000], ids=["brackets", "digits"])
def test_resume__skips_a_line_that_is_not_json(tmp_path: Path, line: str) -> None:
    _store(tmp_path).add(_result("a", 0))
    with (tmp_path / "episodes.partial.jsonl").open("a") as file:
        file.write(line + "\n")
    assert _store(tmp_path, resume=True).done == 10


def test_resumed_results__are_equal_to_the_digit(tmp_path: Path) -> None:
    store = _store(tmp_path)
    store.add(_result("a", 0, error="ValueError: \u2028 odd\n text"))
    rows = _store(tmp_path, resume=True).rows("a")
    assert [row["time_s"] for row in rows] == [row["time_s"] for row in store.rows("a")]
    assert all(math.isnan(row["cost_integral"]) for row in rows)
    assert rows[0]["error"] == "ValueError: \u2028 odd\n text"


@pytest.mark.parametrize(
    "other", [{**CONFIG, "policies": ["a"]}, {**CONFIG, "params": {"l": 0.09}}]
)
def test_resume__refuses_another_config(tmp_path: Path, other: dict[str, Any]) -> None:
    _store(tmp_path).add(_result("a", 0))
    before = (tmp_path / "episodes.partial.jsonl").read_bytes()
    with pytest.raises(InvalidInputError, match="same policies, tasks, options and constants"):
        Store(tmp_path, other, resume=True)
    assert (tmp_path / "episodes.partial.jsonl").read_bytes() == before


@pytest.mark.parametrize("task", [3, 15])
def test_resume__skips_what_is_doubled(tmp_path: Path, task: int) -> None:
    """Two processes may once have written to one journal; the line that was first counts."""
    store = _store(tmp_path)
    store.add(_result("a", 0))
    partial = tmp_path / "episodes.partial.jsonl"
    with partial.open("a") as file:
        for rows in (_result("a", 0), [_row("a", task, phase=1)], [_row("a", task, phase=2)]):
            file.write(json.dumps({"rows": rows}) + "\n")
    again = _store(tmp_path, resume=True)
    assert again.done == (10 if task == 3 else 11)
    (row,) = [row for row in again.rows("a") if row["task"] == task]
    assert row["phase"] == (9 if task == 3 else 1)


def test_resume__begins_where_there_is_nothing(tmp_path: Path) -> None:
    for folder in (tmp_path, tmp_path / "missing"):
        store = _store(folder, resume=True)
        assert store.missing("a") == list(range(30))
        store.add(_result("a", 0))
        assert _store(folder, resume=True).done == 10
        (folder / "episodes.partial.jsonl").unlink()


def test_existing_results__are_refused_or_overwritten(tmp_path: Path) -> None:
    store = _store(tmp_path)
    store.add(_result("a", 0))
    _write(store, {}, complete=True)
    before = (tmp_path / "episodes.csv").read_bytes()
    with pytest.raises(InvalidInputError, match="--overwrite"):
        _store(tmp_path)
    assert (tmp_path / "episodes.csv").read_bytes() == before
    again = _store(tmp_path, overwrite=True)
    assert again.done == 0
    again.add(_result("b", 0))
    _write(again, {}, complete=True)
    assert _written(tmp_path) == [("b", task) for task in range(10)]


def test_overwrite__also_forgets_an_interrupted_run(tmp_path: Path) -> None:
    _store(tmp_path).add(_result("a", 0))
    _store(tmp_path, overwrite=True)
    assert _store(tmp_path, resume=True).done == 0


def test_store_without_folder__writes_nothing(tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.chdir(tmp_path)
    store = Store(None, CONFIG, resume=False)
    store.add(_result("a", 0))
    _write(store, {}, complete=True)
    assert len(store.rows("a")) == 10
    assert names(tmp_path) == set()
