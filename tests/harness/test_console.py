"""What commands print: texts as they are, and what a terminal would obey as an escape."""

import io
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from rich.table import Table

from harness.console import PlainConsole
from harness.progress import progress, tracked
from snake_env.system.exit_code import complain

ODD = [
    *("res[/red]", "res[new]", "[bold]x[/bold]", "[link=file:///]x"),
    *(":100: 1", "a\\[b]", "[@click=f]"),
]
CONTROLS = [
    *("\x1b[2J", "\x1b]0;title\x07", "a\rb", "\x9b31m", "\u202ereversed", "half \udcff a pair")
]


@contextmanager
def _printing() -> Iterator[tuple[PlainConsole, io.StringIO]]:
    file = io.StringIO()
    yield PlainConsole(file=file, width=200), file


@pytest.mark.parametrize("name", ODD)
def test_names__are_no_markup(name: str) -> None:
    with _printing() as (console, file):
        console.print(f"results: {name}/", soft_wrap=True)
        console.print(name, style="bold")
        table = Table("policy", name)
        table.add_row(name, name)
        console.print(table)
        with progress(console, 2, "episodes") as advance:
            advance(name, 2)
    assert file.getvalue().count(name) == 5
    assert f"results: {name}/\n" in file.getvalue()


@pytest.mark.parametrize("name", ODD + CONTROLS)
def test_progress_in_a_terminal__shows_names_as_they_are(name: str) -> None:
    file = io.StringIO()
    console = PlainConsole(file=file, width=200, force_terminal=True)
    with progress(console, 3, "episodes") as advance:
        advance(name, 1)
    if name in ODD:
        assert name in file.getvalue()
    assert not any(char in file.getvalue() for char in "\x9b\u202e\udcff\x07")


@pytest.mark.parametrize("text", CONTROLS)
def test_controls__never_reach_the_terminal(text: str, capsys: Any) -> None:
    with _printing() as (console, file):
        console.print(f"first\n{text}", soft_wrap=True)
        table = Table(text, box=None)
        table.add_row(text)
        console.print(table)
    complain(f"error: {text}")
    written = file.getvalue() + capsys.readouterr().err
    assert written.isascii()
    assert all(char.isprintable() or char == "\n" for char in written)


def test_rate_and_time_left__count_what_is_done_now_only(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [1000.0]
    monkeypatch.setattr("harness.progress.time.monotonic", lambda: now[0])
    with _printing() as (console, file), progress(console, 1_000_000, "decisions", 900_000) as step:
        now[0] += 10.0
        step("ppo", 10_000)
    assert file.getvalue() == "ppo: 910000/1000000 decisions, 1000/s, 90 s left\n"


def test_tracked__passes_on_all_items_and_shows_how_far_they_have_come(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = [1000.0]
    monkeypatch.setattr("harness.progress.time.monotonic", lambda: now[0])
    passed = []
    with _printing() as (console, file):
        for item in tracked(console, "fit", "batches", iter("abc"), 3):
            passed.append(item)
            now[0] += 10.0
    assert passed == ["a", "b", "c"]
    assert file.getvalue().splitlines() == [
        "fit: 1/3 batches, 0/s, 20 s left",
        "fit: 2/3 batches, 0/s, 10 s left",
    ]
