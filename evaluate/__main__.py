"""Command line: ``python -m evaluate POLICY...``, ``compare DIR...`` and ``solve``."""

from __future__ import annotations

import dataclasses
import json
import sys
import time
from collections.abc import Iterator
from contextlib import closing, suppress
from typing import Any

from rich.console import Console

from evaluate.compare import CompareOptions, compare_folders, read_episodes, read_summary
from evaluate.drawings import draw
from evaluate.latency import measure_latencies
from evaluate.options import Options
from evaluate.protocol import Shard, check_policy, run_shard
from evaluate.solve import SolveOptions, solve_suite
from evaluate.store import LAYOUT, Store
from evaluate.summary import build_summary
from evaluate.terminal import print_comparisons, print_results
from evaluate.video import check_wish
from harness.console import console as make_console
from harness.engine import WorkerLostError
from harness.folder import held
from harness.options import parse
from harness.progress import progress
from harness.provenance import begin
from snake_env import VERSION
from snake_env.errors import InvalidInputError
from snake_env.params import SnakeParams
from snake_env.sim.tasks import TaskSuite, load_tasks
from snake_env.sim.warm_up import warm_up
from snake_env.system import interrupts
from snake_env.system.exit_code import complain, exit_code

_MOST_TASKS = 16  # in a shard, so that handing it out costs little beside doing it
_LEAST_SHARDS = 100  # so that all workers are busy to the end, and a killed run loses little


def main(args: list[str] | None = None) -> int:
    """Runs the command; its exit code."""
    words = sys.argv[1:] if args is None else args
    return exit_code(lambda: _command(words))


def _command(words: list[str]) -> int:
    if words == ["--version"]:
        print(VERSION)
        return 0
    if words[:1] == ["compare"]:
        options = parse(CompareOptions, "python -m evaluate compare", words[1:])
        return compare_folders(options, make_console())
    if words[:1] == ["solve"]:
        return _solve(words)
    return evaluate(parse(Options, "python -m evaluate", words))


def _solve(words: list[str]) -> int:
    begin("python -m evaluate", words)
    options = parse(SolveOptions, "python -m evaluate solve", words[1:])
    try:
        solve_suite(options, make_console())
    except WorkerLostError as error:
        complain(f"error: {error}; --resume continues from what is finished")
        return 1
    return 0


def evaluate(options: Options) -> int:
    """Evaluates the policies and reports; the exit code: 0, 130 when interrupted, 1 without workers.

    Raises:
        SnakeEnvError: The options can't be used.
    """
    params = options.check()
    if options.out is not None:  # a policy may change the folder that relative paths begin in
        options = dataclasses.replace(options, out=options.out.absolute())
    models = {name: check_policy(name, params, options.slip) for name in options.names}
    suite = load_tasks(options.tasks, params)
    if options.video:
        check_wish(options.video, suite)
    config = {
        "policies": list(options.names),
        "models": models,
        "tasks": {"name": suite.name, "n": len(suite), "hash": suite.sha256},
        "preset": options.preset,
        "params": dataclasses.asdict(params),
        "slip": list(options.slip),
        "decision_timeout_s": options.decision_timeout,
    }
    flags = {"overwrite": options.overwrite, "resume": options.resume}
    with held(options.out, LAYOUT, **flags) as found:
        if found == "finished":
            return _finished(options, config, params, suite)
        return _evaluate(options, config, params, suite, resume=found == "begun")


def _evaluate(
    options: Options, config: dict[str, Any], params: SnakeParams, suite: TaskSuite, *, resume: bool
) -> int:
    """Runs what is left to do, writes, prints and draws."""
    store = Store(options.out, config, resume=resume)
    warm_up(params)  # compiled once, before there are workers
    console = _console(options)
    began, before = time.monotonic(), store.done
    rows: dict[str, Any] = {}
    latencies: dict[str, list[float]] = {}
    try:
        _run(store, config, suite, params, options, console)
        rows = {name: store.rows(name) for name in options.names}
        duration = time.monotonic() - began
        if not options.no_latency:
            limit = options.decision_timeout
            latencies = measure_latencies(rows, suite, params, limit)
        summary = build_summary(config, rows, latencies, params, options.command)
        store.write(rows, summary)
    except KeyboardInterrupt:
        return _stop("interrupted", 130, store, config, params, options)
    except BrokenPipeError:
        raise
    except (WorkerLostError, OSError) as error:
        return _stop(f"error: {error}", 1, store, config, params, options)
    print_results(make_console(), summary, options.format)
    for name in options.names:
        _print_errors(console, name, rows[name])
    console.print(f"{store.done - before} episodes in {duration:.1f} s")
    code = draw(options, rows, summary, params, suite, console)
    if code == 0:
        store.finish()  # last: until then --resume does what is missing
        print_comparisons(console, summary)
    return code


def _finished(
    options: Options, config: dict[str, Any], params: SnakeParams, suite: TaskSuite
) -> int:
    """Says that there is nothing left to run; draws what is asked for and not there."""
    assert options.out is not None
    summary = read_summary(options.out, "resume")
    same = ("tasks", "params", "models")
    there = [summary["command"], *(summary[key] for key in same)]
    if there != [options.command, *(json.loads(json.dumps(config[key])) for key in same)]:
        same_work = "work with the same policies, model files, tasks, options and constants"
        expected = f"{same_work} (or --overwrite)"
        raise InvalidInputError("resume", str(options.out), expected)
    rows = read_episodes(options.out, summary, {name: name for name in options.names}, "resume")
    console = _console(options)
    print_results(make_console(), summary, options.format)
    console.print("0 episodes: this run is finished")
    code = draw(options, rows, summary, params, suite, console, missing=True)
    print_comparisons(console, summary)
    return code


def _console(options: Options) -> Console:
    """Where all but the tables is printed: the output is theirs where a program will read them."""
    return make_console(error=options.format != "text")


def _shards(
    store: Store,
    config: dict[str, Any],
    suite: TaskSuite,
    params: SnakeParams,
    options: Options,
) -> Iterator[Shard]:
    """What is left to do, made when there is a worker for it."""
    size = max(1, min(_MOST_TASKS, len(suite) // _LEAST_SHARDS))
    for name in options.names:
        missing = store.missing(name)
        for start in range(0, len(missing), size):
            yield Shard.of(
                name,
                suite,
                missing[start : start + size],
                params,
                decision_timeout_s=options.decision_timeout,
                slip=options.slip,
                models=tuple(config["models"][name]),
            )


def _run(
    store: Store,
    config: dict[str, Any],
    suite: TaskSuite,
    params: SnakeParams,
    options: Options,
    console: Console,
) -> None:
    """Runs the shards on the workers; each is stored as it comes."""
    left = sum(len(store.missing(name)) for name in options.names)
    shards = _shards(store, config, suite, params, options)
    with (
        progress(console, left, "episodes") as advance,
        closing(options.engine.map(run_shard, shards)) as results,
    ):
        for rows in results:
            store.add(rows)
            advance(rows[0]["policy"], len(rows))


def _stop(
    why: str,
    code: int,
    store: Store,
    config: dict[str, Any],
    params: SnakeParams,
    options: Options,
) -> int:
    """Ends a run before it is complete: writes what there is, and says so."""
    interrupts.settle()
    rows = {name: store.rows(name) for name in options.names}
    with suppress(OSError):  # on a full disk finished shards have to do
        summary = build_summary(config, rows, {}, params, options.command, complete=False)
        store.write(rows, summary)
    kept = f"in {options.out}: --resume continues from there" if options.out else "lost (no --out)"
    complain(f"{why}: {store.done} finished episodes are {kept}")
    return code


def _print_errors(console: Console, name: str, rows: Any) -> None:
    """Says on which task a policy failed by itself first."""
    wrong = [row for row in rows if row["error"]]
    if wrong:
        more = f" and {len(wrong) - 1:,} more" if len(wrong) > 1 else ""
        text = f"{name}: error on task {wrong[0]['task']}{more}: {wrong[0]['error']}"
        console.print(text, soft_wrap=True)


if __name__ == "__main__":
    interrupts.leave(main())
