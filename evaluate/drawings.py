"""Pictures, report and videos of an evaluation, drawn when all its results are written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich.console import Console

from evaluate.options import Options
from evaluate.protocol import Row
from evaluate.video import write_videos
from harness.console import in_one_line
from harness.files import file_name
from snake_env.params import SnakeParams
from snake_env.sim.tasks import TaskSuite
from snake_env.system.exit_code import complain


def draw(
    options: Options,
    rows: Mapping[str, Sequence[Row]],
    summary: Mapping[str, Any],
    params: SnakeParams,
    suite: TaskSuite,
    console: Console,
    *,
    missing: bool = False,
) -> int:
    """Draws what the options ask for into the folder of results, if there is one; the exit code.

    Args:
        options: What is asked for, and where to.
        rows: Each policy's episodes, by task.
        summary: What ``summary.json`` holds.
        params: The constants.
        suite: The tasks.
        console: Where it is said what is there.
        missing: Whether what is there already stays as it is.
    """
    if options.out is None:
        return 0
    code, why = 0, ""
    try:
        _draw(options, rows, summary, params, suite, console, missing)
    except KeyboardInterrupt:
        code, why = 130, "interrupted"
    except BrokenPipeError:
        raise
    except Exception as problem:  # whatever it is, the results are there, and this says so
        code, why = 1, f"error: drawing failed ({in_one_line(problem)})"
    if code:
        hint = "--resume draws what is missing (with --no-pictures it draws none)"
        complain(f"{why}: the results are in {options.out}: {hint}")
        return code
    console.print(f"results: {options.out}/", soft_wrap=True)
    return 0


def _draw(
    options: Options,
    rows: Mapping[str, Sequence[Row]],
    summary: Mapping[str, Any],
    params: SnakeParams,
    suite: TaskSuite,
    console: Console,
    missing: bool,
) -> None:
    assert options.out is not None
    limit = options.decision_timeout
    pictures = [options.out / f"fig4-{file_name(name)}.png" for name in options.names]
    there = all(path.exists() for path in (*pictures, options.out / "report.html"))
    if not options.no_pictures and not (missing and there):
        from evaluate.pictures import draw_all  # matplotlib takes a while to import
        from evaluate.report import write_report

        draw_all(options.out, rows, params, limit)
        page = write_report(options.out, options.names, rows, summary, params, suite, limit)
        console.print(f"report: {page}", soft_wrap=True)
    if options.video:
        for path in write_videos(
            options.out, options.video, options.names, rows, params, suite, limit, missing=missing
        ):
            console.print(f"video: {path}", soft_wrap=True)
