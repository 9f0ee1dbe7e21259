"""What an evaluation prints."""

from __future__ import annotations

from typing import Any

from rich.console import Console

from evaluate.summary import sentences
from evaluate.table import Format, failure_lines, printed, result_tables


def print_results(where: Console, summary: dict[str, Any], form: Format = "text") -> None:
    """Prints the tables, and which failures there were."""
    for table in result_tables(summary):
        if form == "text":
            where.print(table.title, style="bold", soft_wrap=True)
        where.print(printed(table, form), soft_wrap=form in ("latex", "csv"))
    if form == "text":
        for line in failure_lines(summary):
            where.print(line, soft_wrap=True)


def print_comparisons(where: Console, summary: dict[str, Any]) -> None:
    """Prints what the comparisons say."""
    for sentence in sentences(summary):
        where.print(sentence, soft_wrap=True)
