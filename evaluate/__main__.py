"""Command line: ``python -m evaluate POLICY... [--tasks ...] [--out DIR]``."""

from __future__ import annotations

import dataclasses
import os
import platform
import shlex
import signal
import sys
import threading
import time
from contextlib import closing
from importlib.metadata import version
from typing import Any

import joblib
from rich.console import Console

from evaluate.engine import WorkerLostError
from evaluate.options import Options, parse
from evaluate.progress import progress
from evaluate.protocol import Shard, check_policy, run_shard
from evaluate.statistics import summarise
from evaluate.store import Store
from evaluate.table import failure_lines, result_tables
from evaluate.video import check_wish, write_videos
from snake_env.errors import SnakeEnvError
from snake_env.params import SnakeParams
from snake_env.programs import warm_up
from snake_env.tasks import load_tasks


def main() -> int:
    """Runs the command; its exit code."""
    try:
        options = parse(Options, "python -m evaluate")
        return evaluate(options)
    except SnakeEnvError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130


def evaluate(options: Options) -> int:
    """Evaluates the policies and reports; the exit code: 0, 130 when interrupted, 1 without workers.

    Raises:
        SnakeEnvError: The options can't be used.
    """
    params = options.check()
    for name in options.policies:
        check_policy(name, params)
    suite = load_tasks(options.tasks, params)
    if options.video:
        check_wish(options.video, suite)
    config = {
        "policies": list(options.policies),
        "tasks": {
            "name": suite.name,
            "n": len(suite),
            "hash": joblib.hash((suite.phi0, suite.target)),
        },
        "preset": options.preset,
        "params": dataclasses.asdict(params),
    }
    store = Store(options.out, config, overwrite=options.overwrite, resume=options.resume)
    warm_up(params)  # compiled once, before there are workers
    console = Console(width=None if sys.stdout.isatty() else 100, highlight=False)
    states = [suite.initial(task, params) for task in range(len(suite))]
    shards = [
        Shard(name, [task], [state], params)
        for name in options.policies
        for task, state in enumerate(states)
    ]
    shards = [shard for shard in shards if (shard.policy, shard.tasks[0]) not in store.results]
    _take_signals(signal.default_int_handler)
    began = time.monotonic()
    stopped, code = "", 0
    try:
        _run(shards, store, options, console)
    except KeyboardInterrupt:
        _take_signals(signal.SIG_IGN)  # a worker's may have come before our own
        stopped, code = "interrupted", 130
    except WorkerLostError as error:
        stopped, code = f"error: {error}", 1
    summary = _summary(options, config, store, params)
    store.write(options.policies, summary, complete=not stopped)
    if stopped:
        done = sum(len(result.rows) for result in store.results.values())
        kept = (
            f"in {options.out}: --resume goes on from there" if options.out else "lost (no --out)"
        )
        print(f"{stopped}: {done} finished episodes are {kept}", file=sys.stderr)
        return code
    for title, table in result_tables(summary):
        console.print(title, style="bold", soft_wrap=True, markup=False)
        console.print(table)
    for line in failure_lines(summary):
        console.print(line, soft_wrap=True)
    for name in options.policies:
        for row in [row for row in store.rows(name) if row["error"]][:1]:
            console.print(f"{name} raised on task {row['task']}: {row['error']}", soft_wrap=True)
    console.print(
        f"{sum(len(s.tasks) for s in shards)} episodes in {time.monotonic() - began:.1f} s"
    )
    if options.out is not None:
        rows = {name: store.rows(name) for name in options.policies}
        if not options.no_pictures:
            from evaluate.pictures import draw_all  # matplotlib takes a while to import
            from evaluate.report import write_report

            draw_all(options.out, options.policies, store, params)
            page = write_report(options.out, options.policies, rows, summary, params, suite)
            console.print(f"report: {page}", soft_wrap=True)
        if options.video:
            for path in write_videos(
                options.out, options.video, options.policies, rows, params, suite
            ):
                console.print(f"video: {path}", soft_wrap=True)
        console.print(f"results: {options.out}/", soft_wrap=True)
    return 0


def _take_signals(handler: Any) -> None:
    """What SIGINT and SIGTERM do: only the main thread may say."""
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, handler)


def _run(shards: list[Shard], store: Store, options: Options, console: Console) -> None:
    """Runs the shards on the workers; each is stored as it comes."""
    with (
        progress(console, sum(len(shard.tasks) for shard in shards), "episodes") as advance,
        closing(options.engine.map(_keyed, shards)) as results,
    ):
        for policy, first, result in results:
            store.add((policy, first), result)
            advance(policy, len(result.rows))


def _keyed(shard: Shard) -> tuple[str, int, Any]:
    return shard.policy, shard.tasks[0], run_shard(shard)


def _summary(
    options: Options, config: dict[str, Any], store: Store, params: SnakeParams
) -> dict[str, Any]:
    policies = {}
    for name in options.policies:
        rows = store.rows(name)
        if rows:
            policies[name] = summarise(rows, store.latencies(name), params)
    return {
        "policies": policies,
        **{key: config[key] for key in ("tasks", "preset", "params")},
        "command": "python -m evaluate " + shlex.join(sys.argv[1:]),
        "versions": {
            "snake-mode-env": version("snake-mode-env"),
            "python": platform.python_version(),
            "numpy": version("numpy"),
        },
        "machine": {"processor": platform.machine(), "cores": os.cpu_count()},
    }


if __name__ == "__main__":
    sys.exit(main())
