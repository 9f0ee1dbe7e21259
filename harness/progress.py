"""Progress of long work: a bar in a terminal, plain lines elsewhere."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Protocol, TypeVar

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
    TimeRemainingColumn,
)
from rich.text import Text

from snake_env.errors import escaped

_LINE_EVERY_S = 5.0


class Advance(Protocol):
    """Reports finished units of work."""

    def __call__(self, label: str, count: int) -> None:
        """Adds ``count`` units of the kind ``label``."""


T = TypeVar("T")


def tracked(console: Console, label: str, unit: str, items: Iterable[T], total: int) -> Iterator[T]:
    """Passes on items, of which there are ``total``, and shows how far they have come."""
    with progress(console, total, unit) as advance:
        for item in items:
            yield item
            advance(label, 1)


class _LabelColumn(ProgressColumn):
    def render(self, task: Task) -> Text:
        return Text(escaped(task.description))  # a name, not markup


class _RateColumn(ProgressColumn):
    def render(self, task: Task) -> Text:
        return Text(f"{task.speed or 0.0:.0f}/s", style="progress.data.speed")


@contextmanager
def progress(console: Console, total: int, unit: str, before: int = 0) -> Iterator[Advance]:
    """Shows how far ``total`` units of work have come, at which rate, and the time left.

    Args:
        console: Where to.
        total: Units of work.
        unit: What they are called.
        before: Units that were done before; they say nothing about the rate.

    Yields:
        A function that takes a label and the number of units just finished.
    """
    if console.is_terminal:
        bar = Progress(
            _LabelColumn(),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn(unit),
            _RateColumn(),
            TimeRemainingColumn(),
            console=console,
            transient=True,
        )
        with bar:
            task = bar.add_task("", total=total, completed=before)
            yield lambda label, count: bar.update(task, advance=count, description=label)
        return
    began = last = time.monotonic()
    done = before

    def line(label: str, count: int) -> None:
        nonlocal done, last
        done += count
        now = time.monotonic()
        if now - last >= _LINE_EVERY_S and done < total:
            last = now
            rate = (done - before) / (now - began)
            left = (total - done) / rate
            console.print(f"{label}: {done}/{total} {unit}, {rate:.0f}/s, {left:.0f} s left")

    yield line
