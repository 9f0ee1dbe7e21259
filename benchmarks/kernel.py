"""Speed of decisions: ``python -m benchmarks.kernel``.

Ratios are measured side by side, in turns, in this one run.
"""

from __future__ import annotations

import functools
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable

import numpy as np
from rich.table import Table
from threadpoolctl import threadpool_limits

from benchmarks.operations import composition, processor
from evaluate.protocol import Shard, run_shard
from evaluate.replay import replay
from harness.console import console as make_console
from snake_env.kernel.blocks import block_width, clock_of, constants_of
from snake_env.kernel.compiler import CACHE_VARIABLE
from snake_env.kernel.interval import (
    PADDING,
    RUNNING,
    Kernel,
    Lane,
    get_kernel,
    sub_step,
)
from snake_env.modes import mode_table
from snake_env.params import N_JOINTS_RANGE, SnakeParams
from snake_env.policies.registry import load_policy
from snake_env.sim.optimizer import AnalyticOptimizer
from snake_env.sim.simulation import predict
from snake_env.sim.tasks import load_tasks
from snake_env.state import SnakeState

_REPEATS = 15
_POLICIES = ("analytic", "analytic-14", "value", "imitate", "ppo", "dqn", "ppo+shield")


def main() -> None:
    """Measures everything and prints it."""
    console = make_console()
    console.print(f"{processor()}, {os.cpu_count()} cores, one thread used")
    params = SnakeParams()
    state = load_tasks("sim-1", params).initial(0, params)
    for title, columns, rows in (
        ("one decision of (21) in phase 1: 99 modes, 150 sub-steps each", *decision(state, params)),
        ("the kernel's loop", *loop(state, params)),
        ("the kernel against the same work done otherwise", *ratios(state, params)),
        ("all modes of phase 1, by number of joints", *scaling()),
        (
            "a decision, features and mask included; a policy's decisions in a row",
            *policies(params),
        ),
        ("start", *start()),
        ("python -m evaluate analytic --tasks paper-500", *experiment()),
    ):
        table = Table(title=title, title_justify="left", title_style="bold")
        for column in columns:
            table.add_column(column, justify="right" if column != columns[0] else "left")
        for row in rows:
            table.add_row(*row)
        console.print(table)


def timed(*functions: Callable[[], object], repeats: int = _REPEATS) -> list[list[float]]:
    """Durations of each function [s], called in turns after a warm-up."""
    durations: list[list[float]] = [[] for _ in functions]
    for repeat in range(repeats + 1):
        for function, kept in zip(functions, durations, strict=True):
            began = time.perf_counter()
            function()
            if repeat > 0:
                kept.append(time.perf_counter() - began)
    return durations


def _ms(seconds: list[float]) -> tuple[str, str]:
    return f"{1e3 * min(seconds):.2f}", f"{1e3 * statistics.median(seconds):.2f}"


def decision(state: SnakeState, params: SnakeParams) -> tuple[list[str], list[list[str]]]:
    """Time of a full decision, over several initial shapes."""
    optimizer = AnalyticOptimizer(params)
    suite = load_tasks("random:20:1", params)
    states = [state, *(suite.initial(task, params) for task in range(len(suite)))]
    (times,) = timed(lambda: [optimizer.select(s) for s in states])
    each = [t / len(states) for t in times]
    per_step = statistics.median(each) / len(mode_table(params.n_joints)) / params.n_steps
    row = [*_ms(each), f"{1e9 * per_step:.0f}", f"{1 / statistics.median(each):.0f}"]
    return ["min [ms]", "median [ms]", "ns per mode-sub-step", "decisions/s"], [row]


def loop(state: SnakeState, params: SnakeParams) -> tuple[list[str], list[list[str]]]:
    """Operations of the kernel's loop, and its time against the least possible."""
    kernel = get_kernel(params.n_joints, params.head_contact, block_width())
    (times,) = timed(_runner(kernel, state, params))
    return composition(kernel, 1e9 * min(times) / len(_modes(params)) / params.n_steps)


def _modes(params: SnakeParams) -> np.ndarray:
    """Modes of phase 1 that fill blocks of any width."""
    return mode_table(params.n_joints).valid(1)[:96]


def _runner(kernel: Kernel, state: SnakeState, params: SnakeParams) -> Callable[[], None]:
    """An interval with each of these modes, from fresh blocks."""
    filled = filled_blocks(kernel, state, _modes(params), params)
    blocks = kernel.blocks(len(_modes(params)))

    def function() -> None:
        blocks[:] = filled
        kernel.run(blocks, constants_of(params), clock_of(params))

    return function


def ratios(state: SnakeState, params: SnakeParams) -> tuple[list[str], list[list[str]]]:
    """The kernel on full blocks, lane by lane, and the equations on plain floats."""
    modes = _modes(params)
    wide, narrow = (
        get_kernel(params.n_joints, params.head_contact, lanes) for lanes in (block_width(), 1)
    )
    run_wide, run_narrow = _runner(wide, state, params), _runner(narrow, state, params)

    def floats() -> None:
        lane = float_lane(state, int(modes[50]), params)
        for t, k_eta in clock_of(params).tolist():
            sub_step(lane, t, k_eta, params)

    fast, slow, python = timed(run_wide, run_narrow, floats, repeats=5)
    steps = params.n_steps
    unit = [
        statistics.median(fast) / len(modes) / steps,
        statistics.median(slow) / len(modes) / steps,
        statistics.median(python) / steps,
    ]
    names = [
        f"kernel, blocks of {wide.lanes} lanes",
        "kernel, one lane at a time",
        "the same equations on Python floats, mode by mode",
    ]
    rows = [
        [name, f"{1e9 * u:.0f}", f"{u / unit[0]:.1f}"] for name, u in zip(names, unit, strict=True)
    ]
    return ["", "ns per mode-sub-step", "times the kernel's"], rows


def float_lane(state: SnakeState, mode: int, params: SnakeParams) -> Lane:
    """A state with a mode as a lane of plain floats, on which the equations run unrewritten."""
    table = mode_table(params.n_joints)
    lifted = table.lifted_wheels(np.array([mode]), np.array([state.phase]))[0]
    return Lane(
        phi=state.phi.tolist(),
        w=state.w.tolist(),
        u=[0.0] * params.n_joints,
        integral=0.0,
        duration=0.0,
        violation=RUNNING,
        d2_min=float("inf"),
        max_abs_phi=0.0,
        phase=float(state.phase),
        target=float(state.target[state.phase - 1]),
        ref_start=float(state.ref_start),
        phase_time=float(state.phase_time),
        grounded=[float(not up) for up in lifted],
        wheels=[float(wheel) for wheel in table.wheels[mode]],
    )


def filled_blocks(
    kernel: Kernel, state: SnakeState, modes: np.ndarray, params: SnakeParams
) -> np.ndarray:
    """A lane buffer with one state and many modes."""
    blocks = kernel.blocks(len(modes))
    blocks[:] = 0.0
    blocks[:, kernel.rows["violation"]] = PADDING
    for position, mode in enumerate(modes):
        lane = float_lane(state, int(mode), params)
        block, k = divmod(position, kernel.lanes)
        for name, rows in kernel.rows.items():
            blocks[block, rows, k] = getattr(lane, name)
        blocks[block, kernel.rows["violation"], k] = RUNNING
    return blocks


def scaling() -> tuple[list[str], list[list[str]]]:
    """Cost of predicting all modes of phase 1 for more and fewer joints."""
    low, high = N_JOINTS_RANGE
    rows = []
    for n in range(low, high + 1):
        params = SnakeParams(n_joints=n)
        state = SnakeState.initial([0.3, -0.3] * (n // 2) + [0.3] * (n % 2), [0.2] * n, params)
        modes = mode_table(n).valid(1)
        one = functools.partial(predict, state, modes, params)
        (times,) = timed(one, repeats=2 if n > 12 else 5)
        each = min(times)
        rows.append(
            [
                str(n),
                str(len(modes)),
                f"{1e3 * each:.2f}",
                f"{1e9 * each / len(modes) / params.n_steps:.0f}",
            ]
        )
    return ["n_joints", "modes", "all modes [ms]", "ns per mode-sub-step"], rows


def policies(params: SnakeParams) -> tuple[list[str], list[list[str]]]:
    """How long policies think about the same states, those of whole episodes."""
    suite = load_tasks("random:20:1", params)
    states = []
    for task in range(len(suite)):
        state = suite.initial(task, params)
        (row,) = run_shard(Shard("imitate", [task], [state], params))
        states += replay(row, state, params).states[:-1]
    rows = []
    with threadpool_limits(1):
        for name in _POLICIES:
            policy = load_policy(name, params)
            rollouts = policy.rollouts
            times = []
            for state in states * 5:
                policy.reset()
                began = time.perf_counter()
                policy.select_mode(state)
                times.append(time.perf_counter() - began)
            spread = np.percentile(times[len(states) :], [50, 95])  # the first round warms up
            each = (policy.rollouts - rollouts) / len(times)
            rows.append([name, *(f"{1e6 * t:.0f}" for t in spread), f"{each:.1f}"])
    return ["policy", "median [us]", "95 % [us]", "roll-outs"], rows


def start() -> tuple[list[str], list[list[str]]]:
    """Import, first result with an empty and with a filled cache, each in a fresh process."""
    first = (
        "from snake_env import *; p = SnakeParams(); "
        "AnalyticOptimizer(p).select(load_tasks('sim-1', p).initial(0, p))"
    )
    rows = []
    with tempfile.TemporaryDirectory() as cache:
        for name, code in (
            ("python -c pass", "pass"),
            ("import snake_env", "import snake_env"),
            ("first decision, kernel compiled", first),
            ("first decision, kernel from the cache", first),
        ):
            began = time.perf_counter()
            subprocess.run(
                [sys.executable, "-c", code],
                env={**os.environ, CACHE_VARIABLE: cache},
                check=True,
                capture_output=True,
            )
            rows.append([name, f"{time.perf_counter() - began:.2f}"])
    return ["fresh process", "wall [s]"], rows


def experiment() -> tuple[list[str], list[list[str]]]:
    """The paper's experiment as a user runs it, start of Python and workers included."""
    rows = []
    for workers in (1, os.cpu_count() or 1):
        command = [sys.executable, "-m", "evaluate", "analytic", "--workers", str(workers)]
        began = time.perf_counter()
        subprocess.run(command, check=True, capture_output=True)
        elapsed = time.perf_counter() - began
        rows.append([str(workers), f"{elapsed:.1f}", f"{500 / elapsed:.0f}"])
    return ["workers", "wall [s]", "tasks/s"], rows


if __name__ == "__main__":
    main()
