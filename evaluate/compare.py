"""``python -m evaluate compare DIR...``: finished runs on the same tasks against each other."""

from __future__ import annotations

import csv
import errno
import math
import os
import shlex
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.console import Console

from evaluate.protocol import Row
from evaluate.rows import Rows, pack, parsed
from evaluate.statistics import summarise
from evaluate.store import LAYOUT, write_results
from evaluate.summary import build_summary
from evaluate.terminal import print_comparisons, print_results
from harness.files import FileError, read_json
from harness.folder import held
from snake_env.errors import InvalidInputError, SnakeEnvError, as_finite
from snake_env.params import SnakeParams
from snake_env.sim.slip import check_slip
from snake_env.sim.tasks import load_tasks

_PACKED_AT_ONCE = 1000  # rows


@dataclass(frozen=True)
class CompareOptions:
    """Compare finished runs on the same tasks; the baseline is the first folder's first policy."""

    folders: Annotated[
        tuple[Path, ...],
        tyro.conf.Positional,
        tyro.conf.arg(metavar="DIR...", help_behavior_hint=""),
    ]
    """Result folders of python -m evaluate."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Folder for the combined report.html, summary.json and episodes.csv."""
    overwrite: bool = False
    """Replace the results in --out."""

    def check(self) -> None:
        """Raises InvalidInputError where the options can't be used."""
        if not self.folders:
            raise InvalidInputError("DIR", self.folders, "at least one result folder")
        times = Counter(folder.resolve() for folder in self.folders)
        for folder in self.folders:
            if times[folder.resolve()] > 1:
                raise InvalidInputError("DIR", str(folder), "each folder once")
        if self.out is not None and self.out.resolve() in times:
            raise InvalidInputError("out", str(self.out), "none of the folders that are compared")
        if self.out is None and self.overwrite:
            raise InvalidInputError("out", None, "a folder: --overwrite requires --out")


def compare_folders(options: CompareOptions, console: Console) -> int:
    """Reads the folders, compares all their policies and prints the result; the exit code.

    Raises:
        InvalidInputError: A folder is unfinished, damaged or foreign, or of other tasks or constants.
    """
    options.check()
    summaries = {folder: read_summary(folder) for folder in options.folders}
    first = options.folders[0]
    for folder in options.folders[1:]:
        check_same(first, summaries[first], folder, summaries[folder])
    params = SnakeParams().replace(**summaries[first]["params"])
    rows: dict[str, Sequence[Row]] = {}
    latencies: dict[str, Any] = {}
    models: dict[str, list[str]] = {}
    for folder, names in _names(summaries).items():
        rows |= read_episodes(folder, summaries[folder], names)
        for own, name in names.items():
            latencies[name] = summaries[folder]["policies"][own]["decision_latency_us"]
            models[name] = summaries[folder]["models"][own]
    command = shlex.join(["python", "-m", "evaluate", "compare", *map(str, options.folders)])
    config = {**summaries[first], "models": models}
    summary = build_summary(config, rows, {}, params, command)
    for name, figures in summary["policies"].items():
        figures["decision_latency_us"] = latencies[name]
    if options.out is not None:
        with held(options.out, LAYOUT, overwrite=options.overwrite):
            write_results(options.out, rows, summary)
            page = _report(options.out, rows, summary, params)
    print_results(console, summary)
    if options.out is not None:
        console.print(page, soft_wrap=True)
        console.print(f"results: {options.out}/", soft_wrap=True)
    print_comparisons(console, summary)
    return 0


def _report(
    out: Path, rows: Mapping[str, Sequence[Row]], summary: Mapping[str, Any], params: SnakeParams
) -> str:
    """Writes the page, where the tasks are at hand; says where it is, or why there is none."""
    from evaluate.report import write_report  # takes a while to import

    try:
        suite = load_tasks(summary["tasks"]["name"], params)
    except SnakeEnvError as error:
        return f"no report: the tasks are not there ({error})"
    if suite.sha256 != summary["tasks"]["hash"]:
        return f"no report: the tasks in {suite.name} have changed"
    return f"report: {write_report(out, tuple(rows), rows, summary, params, suite, None)}"


def _names(summaries: Mapping[Path, Any]) -> dict[Path, dict[str, str]]:
    """What the policies of each folder are called: with the folder, where several have one."""
    times = Counter(name for summary in summaries.values() for name in summary["policies"])
    return {
        folder: {
            name: name if times[name] == 1 else f"{name} ({folder})" for name in summary["policies"]
        }
        for folder, summary in summaries.items()
    }


def read_summary(folder: Path, field: str = "DIR") -> dict[str, Any]:
    """The ``summary.json`` of a finished run.

    Args:
        folder: The run's folder.
        field: What an error calls it.

    Raises:
        InvalidInputError: There is none, the run is not finished, or it is no such file.
    """
    path = folder / LAYOUT.done
    if LAYOUT.found(folder) == "begun":
        raise InvalidInputError(field, str(folder), "a finished run (--resume finishes it)")
    try:
        summary = read_json(path)
        _check_summary(summary)
    except FileError as error:
        if not path.exists():
            expected = f"a result folder ({path.name}: {error})"
            raise InvalidInputError(field, str(folder), expected) from None
        raise InvalidInputError(field, str(path), f"the summary of a run ({error})") from None
    except (ValueError, TypeError, LookupError, AttributeError, SnakeEnvError) as error:
        expected = f"the summary of a run ({type(error).__name__}: {error})"
        raise InvalidInputError(field, str(path), expected) from None
    return summary  # type: ignore[no-any-return]


def _check_summary(summary: Any) -> None:
    """Raises an error of Python's or ours unless it is what a run writes."""
    kinds: tuple[tuple[str, type], ...] = (("name", str), ("n", int), ("hash", str))
    for key, kind in kinds:
        if type(summary["tasks"][key]) is not kind:
            raise ValueError(f"tasks.{key} is {summary['tasks'][key]!r}")
    SnakeParams().replace(**summary["params"])
    kinds = (("preset", str), ("command", str), ("policies", dict))
    for key, kind in kinds:
        if type(summary[key]) is not kind:
            raise ValueError(f"{key} is {summary[key]!r}")
    check_slip(summary["slip"])
    if not summary["policies"]:
        raise ValueError("no policies")
    models = summary.setdefault("models", {})  # a version before this did not tell
    for name in summary["policies"]:
        digests = models.setdefault(name, [])
        if type(digests) is not list or not all(type(digest) is str for digest in digests):
            raise ValueError(f"models of {name} are {digests!r}")
    for figures in summary["policies"].values():
        for key in ("p50", "p95", "p99"):
            value = figures["decision_latency_us"][key]
            latency = 0.0 if value is None else as_finite(value)
            if latency is None or latency < 0.0:
                raise ValueError(f"{key} is {value!r}")


def check_same(first: Path, one: Mapping[str, Any], folder: Path, other: Mapping[str, Any]) -> None:
    """Checks whether two runs can be compared.

    Raises:
        InvalidInputError: Their constants or their tasks differ; the message names what.
    """
    for key, value in one["params"].items():
        if other["params"].get(key) != value:
            field, expected = f"{key} in {folder}", f"{value!r}, as in {first}"
            raise InvalidInputError(field, other["params"].get(key), expected)
    if other["slip"] != one["slip"]:
        expected = f"{one['slip']}, as in {first}"
        raise InvalidInputError(f"slip in {folder}", other["slip"], expected)
    if other["tasks"]["hash"] != one["tasks"]["hash"]:
        expected = f"the tasks of {first}, {one['tasks']['name']}"
        if other["tasks"]["name"] == one["tasks"]["name"]:
            expected += ", with the same shapes"
        raise InvalidInputError(f"tasks of {folder}", other["tasks"]["name"], expected)


def read_episodes(
    folder: Path, summary: Mapping[str, Any], names: Mapping[str, str], field: str = "DIR"
) -> dict[str, Rows]:
    """The episodes of a finished run, by policy.

    Args:
        folder: The run's folder.
        summary: Its summary.
        names: What its policies are to be called.
        field: What an error calls the folder.

    Raises:
        InvalidInputError: ``episodes.csv`` is damaged, or does not fit the summary.
    """
    path = folder / "episodes.csv"
    packed: dict[str, list[Any]] = {policy: [] for policy in names}
    reader = _parsed_rows(path, names, field)
    while block := list(islice(reader, _PACKED_AT_ONCE)):
        for policy in dict.fromkeys(row["policy"] for row in block):
            own = (row | {"policy": names[policy]} for row in block if row["policy"] == policy)
            packed[policy].append(pack(own))
    rows = {}
    for policy, parts in packed.items():
        own_rows = Rows(parts)
        _check_figures(path, policy, own_rows, summary, field)
        rows[names[policy]] = own_rows
    return rows


def _parsed_rows(path: Path, names: Mapping[str, str], field: str) -> Iterator[Row]:
    try:
        if not path.is_file():
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT))
        file = path.open(newline="", encoding="utf-8")
    except OSError as error:
        expected = f"a result folder ({path.name}: {error.strerror})"
        raise InvalidInputError(field, str(path.parent), expected) from None
    with file:
        reader = csv.DictReader(file, strict=True)
        try:
            for texts in reader:
                row = parsed(texts)
                if row["policy"] not in names:
                    raise ValueError(f"policy {row['policy']!r} is not in the summary")
                yield row
        except (ValueError, TypeError, csv.Error) as error:
            expected = f"the episodes of a run (line {reader.line_num}: {error})"
            raise InvalidInputError(field, str(path), expected) from None


def _check_figures(
    path: Path, policy: str, rows: Rows, summary: Mapping[str, Any], field: str
) -> None:
    """Raises InvalidInputError unless the summary's figures of a policy follow from its episodes."""
    n = summary["tasks"]["n"]
    if len(rows) != n or rows.column("task").tolist() != list(range(n)):
        expected = f"one row for each of {n:,} tasks; {policy} has {len(rows):,} rows"
        raise InvalidInputError(field, str(path), expected)
    params = SnakeParams().replace(**summary["params"])
    follow, given = summarise(rows, (), params), summary["policies"][policy]
    for key, value in follow.items():
        if key not in ("name", "decision_latency_us") and not _same(given.get(key), value):
            reason = f"{key} of {policy} is {given.get(key)!r}; its episodes give {value!r}"
            raise InvalidInputError(field, str(path.parent), f"figures of its episodes ({reason})")


def _same(given: Any, follows: Any) -> bool:
    """Whether two figures are equal, but for the last digits of sums."""
    if isinstance(follows, dict):
        return (
            isinstance(given, dict)
            and given.keys() == follows.keys()
            and all(_same(given[key], follows[key]) for key in follows)
        )
    if isinstance(follows, list):
        return (
            isinstance(given, list)
            and len(given) == len(follows)
            and all(map(_same, given, follows))
        )
    if isinstance(follows, float):
        number = as_finite(given)
        return number is not None and math.isclose(number, follows, rel_tol=1e-9, abs_tol=1e-12)
    return type(given) is type(follows) and bool(given == follows)
