"""Speed of the vector env: ``python -m benchmarks.vector [--soak STEPS] [--plot FILE]``.

Every env is driven with random valid modes; only ``step`` is timed. The envs that are compared take
turns in this one run.
"""

from __future__ import annotations

import functools
import os
import resource
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import gymnasium
import numpy as np
from rich.table import Table

from harness.console import console as make_console
from harness.options import parse
from snake_env import set_num_threads
from snake_env.system.exit_code import exit_code

_ID = "snake_env:SnakeModeSelection-v0"
_COUNTS = (1, 4, 16, 64, 256, 1024, 4096)
_SECONDS = 2.0
_TURNS = 3


@dataclass(frozen=True)
class Options:
    """Measure the vector env beside SyncVectorEnv and SB3's SubprocVecEnv."""

    soak: int = 5_000_000
    """Steps to run while watching the memory."""
    plot: Path | None = None
    """Picture of the speed against the number of envs."""


class Driver:
    """Steps a vector env with random valid modes.

    Attributes:
        count: Number of envs.
        name: What it is.
    """

    def __init__(self, name: str, count: int, env: Any, masks: Callable[[], Any]) -> None:
        self.name, self.count = name, count
        self._env, self._masks = env, masks
        self._rng = np.random.default_rng(0)

    def run(self, seconds: float) -> float:
        """Steps of one env per second, over at least so long."""
        stepped, spent = 0, 0.0
        while spent < seconds:
            masks = np.asarray(self._masks())
            modes = (masks * self._rng.random(masks.shape)).argmax(axis=1)
            began = time.perf_counter()
            self._env.step(modes)
            spent += time.perf_counter() - began
            stepped += self.count
        return stepped / spent


def native(count: int) -> Driver:
    """The native vector env."""
    env = gymnasium.make_vec(_ID, num_envs=count)
    env.reset(seed=0)
    return Driver("native vector env", count, env, cast(Any, env.unwrapped).action_masks)


def sync(count: int) -> Driver:
    """Gymnasium's SyncVectorEnv."""
    env = gymnasium.make_vec(_ID, num_envs=count, vectorization_mode="sync")
    env.reset(seed=0)
    return Driver("SyncVectorEnv", count, env, lambda: cast(Any, env).call("action_masks"))


def subproc(count: int) -> Driver:
    """SB3's SubprocVecEnv, one process for each env."""
    from stable_baselines3.common.vec_env import SubprocVecEnv

    env = SubprocVecEnv([functools.partial(gymnasium.make, _ID)] * count)
    env.reset()
    return Driver("SB3 SubprocVecEnv", count, env, lambda: env.env_method("action_masks"))


def compare() -> list[tuple[str, int, int, float]]:
    """(name, threads or processes, envs, best steps/s) of each env, measured in turns."""
    cores = os.cpu_count() or 1
    runs = [
        (native(1024), 1),
        (native(1024), cores),
        (sync(64), 1),
        (subproc(4 * cores), 1),
    ]
    best = [0.0] * len(runs)
    for _ in range(_TURNS):
        for k, (driver, threads) in enumerate(runs):
            set_num_threads(threads)
            best[k] = max(best[k], driver.run(_SECONDS))
    set_num_threads(1)
    processes = [1, cores, 1, 4 * cores]
    return [
        (driver.name, processes[k], driver.count, best[k]) for k, (driver, _) in enumerate(runs)
    ]


def soak(steps: int) -> tuple[float, float]:
    """Peak memory [MiB] early in a long run and at its end."""
    driver = native(1024)
    driver.run(_SECONDS)
    early = _peak_mib()
    done = 0
    while done < steps:
        done += int(driver.run(_SECONDS) * _SECONDS)
    return early, _peak_mib()


def _peak_mib() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def plot(path: Path) -> None:
    """Draws steps/s against the number of envs."""
    from harness.figures import Figure

    figure = Figure(figsize=(7, 4), layout="constrained")
    ax = figure.subplots()
    for make, counts, colour in (
        (native, _COUNTS, "#0b6e4f"),
        (sync, [c for c in _COUNTS if c <= 256], "#3a6ea5"),
    ):
        drivers = [make(count) for count in counts]
        speeds = [max(driver.run(0.7) for _ in range(2)) for driver in drivers]
        ax.loglog(counts, speeds, "o-", color=colour, label=drivers[0].name)
        ax.annotate(
            f"{speeds[-1]:,.0f}", (counts[-1], speeds[-1]), xytext=(0, 7),
            textcoords="offset points", ha="center", color=colour,
        )  # fmt: skip
    ax.set_xlabel("envs")
    ax.set_ylabel("env steps per second, one thread")
    ax.set_ylim(top=2e5)
    ax.grid(alpha=0.3)
    ax.spines[["top", "right"]].set_visible(False)
    ax.legend(frameon=False)
    figure.savefig(path, dpi=130)


def main(args: list[str] | None = None) -> int:
    """Measures and prints; the exit code."""
    options = parse(Options, "python -m benchmarks.vector", args)
    console = make_console()
    rows = compare()
    title = "vector env, random valid modes"
    table = Table(title=title, title_justify="left", title_style="bold")
    for column in ("", "threads or processes", "envs", "env steps/s", "native, same cores / this"):
        table.add_column(column, justify="right" if column else "left")
    for name, processes, count, speed in rows:
        rival = rows[1][3] if processes > 1 else rows[0][3]
        table.add_row(name, str(processes), str(count), f"{speed:,.0f}", f"{rival / speed:.1f}")
    console.print(table)
    early, late = soak(options.soak)
    console.print(
        f"peak memory: {early:.0f} MiB at first, {late:.0f} MiB after {options.soak:,} steps"
    )
    if options.plot is not None:
        plot(options.plot)
        console.print(f"picture: {options.plot}")
    return 0


if __name__ == "__main__":
    sys.exit(exit_code(main))
