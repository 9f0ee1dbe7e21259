"""Results that anybody may have damaged: read, or refused in one line."""

import io
import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from evaluate.compare import CompareOptions, compare_folders
from evaluate.protocol import COLUMNS
from evaluate.store import Store, write_results
from evaluate.summary import build_summary
from harness.console import PlainConsole
from snake_env.errors import InvalidInputError
from tests.support.damage import damaged
from tests.support.evaluations import SUITE, rows_of
from tests.support.robots import PAPER

FUZZ = settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
CONFIG: dict[str, Any] = {
    "policies": ["random"],
    "tasks": {"name": SUITE.name, "n": len(SUITE), "hash": SUITE.sha256},
    "preset": "paper",
    "params": {name: getattr(PAPER, name) for name in PAPER.__dataclass_fields__},
    "slip": [0.0, 0.0],
    "models": {"random": []},
}
VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3)
    ),
    max_leaves=5,
)


def _changed(value: Any, data: st.DataObject) -> Any:
    """A value of JSON in which one value, however deep, is another one, or gone."""
    if isinstance(value, dict) and value and data.draw(st.booleans()):
        key = data.draw(st.sampled_from(sorted(value)))
        rest = {name: value[name] for name in value if name != key}
        return data.draw(st.sampled_from([rest, {**value, key: _changed(value[key], data)}]))
    if isinstance(value, list) and value and data.draw(st.booleans()):
        at = data.draw(st.integers(0, len(value) - 1))
        return [*value[:at], _changed(value[at], data), *value[at + 1 :]]
    return data.draw(VALUES)


def _one_line(action: Any) -> str:
    """Runs it; what it was refused with, if it was."""
    try:
        action()
    except InvalidInputError as error:
        return str(error)
    return ""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A finished run."""
    rows = {"random": rows_of("random")}
    write_results(tmp_path, rows, build_summary(CONFIG, rows, {}, PAPER, "python -m evaluate"))
    return tmp_path


def _compare(folder: Path) -> None:
    compare_folders(CompareOptions((folder,)), PlainConsole(file=io.StringIO()))


@FUZZ
@given(data=st.data())
def test_any_summary__is_read_or_refused(folder: Path, data: st.DataObject) -> None:
    path = folder / "summary.json"
    good = path.read_bytes()
    try:
        content = json.dumps(_changed(json.loads(good), data)).encode()
        path.write_bytes(data.draw(st.sampled_from([content, damaged(good, data)])))
        assert "\n" not in _one_line(lambda: _compare(folder))
    finally:
        path.write_bytes(good)


@FUZZ
@given(data=st.data())
def test_any_episodes__are_read_or_refused(folder: Path, data: st.DataObject) -> None:
    path = folder / "episodes.csv"
    good = path.read_bytes()
    try:
        path.write_bytes(damaged(good, data))
        assert "\n" not in _one_line(lambda: _compare(folder))
    finally:
        path.write_bytes(good)


@FUZZ
@given(data=st.data())
def test_any_journal__is_resumed_or_refused(tmp_path: Path, data: st.DataObject) -> None:
    path = tmp_path / "episodes.partial.jsonl"
    path.unlink(missing_ok=True)
    store = Store(tmp_path, CONFIG, resume=False)
    for row in rows_of("random")[:4]:
        store.add([row])
    header, *lines = path.read_text().splitlines(keepends=True)
    at = data.draw(st.integers(0, 3))
    entry = _changed(json.loads(lines[at]), data)
    lines[at] = json.dumps(entry) + "\n"
    crafted = (header + "".join(lines)).encode()
    path.write_bytes(data.draw(st.sampled_from([crafted, damaged(path.read_bytes(), data)])))
    resumed: list[Store] = []
    told = _one_line(lambda: resumed.append(Store(tmp_path, CONFIG, resume=True)))
    assert "\n" not in told
    for again in resumed:
        assert 0 <= again.done <= len(SUITE)
        assert all(tuple(row) == COLUMNS for row in again.rows("random"))
