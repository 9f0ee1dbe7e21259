"""``python -m snake_env``: check an installation, make a GIF, play."""

from __future__ import annotations

import argparse
import importlib.util
import platform
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

import gymnasium
import numpy as np
from gymnasium.utils.env_checker import check_env

from snake_env import VERSION
from snake_env.envs.env import SnakeModeSelectionEnv
from snake_env.errors import InvalidInputError, SnakeEnvError
from snake_env.kernel.compiler import cache_folder
from snake_env.modes import ModeTable, mode_table
from snake_env.params import PRESETS, SnakeParams, parse_overrides
from snake_env.policies.registry import POLICIES, load_policy
from snake_env.rendering.painter import Painter, save_gif
from snake_env.rendering.scenes import Scene, motion_scenes, still_scene
from snake_env.sim.episode import Episode
from snake_env.sim.optimizer import AnalyticOptimizer, Selection
from snake_env.sim.simulation import advance
from snake_env.sim.tasks import load_tasks
from snake_env.state import SnakeState
from snake_env.system import interrupts
from snake_env.system.exit_code import exit_code

_SIM_1_SECONDS = 36.0
_LISTED = 15
_ENDS_AT_REST = ("success", "deadlock", "horizon")
_NOTHING = "no mode is feasible"
_HELP = """\
  a number    that mode           5 7 8 up    the mode that lifts these rear wheels
  a           optimiser's choice  l           the cheapest modes
  q           quit                ?           this help"""


def main(arguments: list[str] | None = None) -> int:
    """Runs the command line; its exit code."""
    return exit_code(lambda: _command(arguments))


def _command(arguments: list[str] | None) -> int:
    options = _parser().parse_args(arguments)
    command: Callable[[argparse.Namespace], int] = options.command
    return command(options)


class _Parser(argparse.ArgumentParser):
    """Complains in one line."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"error: {message} (see {self.prog} --help)\n")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="python -m snake_env", description=__doc__)
    parser.add_argument("--version", action="version", version=VERSION)
    commands = parser.add_subparsers(required=True, metavar="COMMAND", parser_class=_Parser)
    check = commands.add_parser("check", help="test this installation in a few seconds")
    check.set_defaults(command=_check)
    gif = commands.add_parser("gif", help="play a task with a policy and write an animated GIF")
    names = ", ".join(POLICIES)
    gif.add_argument(
        "--policy", default="analytic", help=f"{names}, or a model file; +shield, +critic"
    )
    gif.add_argument("--out", type=Path, default=Path("snake.gif"), help="file (snake.gif)")
    gif.set_defaults(command=_gif)
    play = commands.add_parser("play", help="choose the modes yourself")
    play.add_argument("--window", action="store_true", help="show the motion in a window")
    play.set_defaults(command=_play)
    for command in (gif, play):
        command.add_argument("--tasks", default="sim-1", help="suite or .npz file (sim-1)")
        command.add_argument("--task", type=int, default=0, help="row of the suite (0)")
        command.add_argument("--preset", default="paper", help="any of: " + ", ".join(PRESETS))
        command.add_argument(
            "--set",
            action="append",
            default=[],
            metavar="NAME=VALUE",
            help="change a constant of the robot",
        )
    return parser


def _begin(options: argparse.Namespace) -> tuple[SnakeState, SnakeParams]:
    params = SnakeParams.preset(options.preset, **parse_overrides(options.set))
    suite = load_tasks(options.tasks, params)
    if not 0 <= options.task < len(suite):
        raise InvalidInputError("task", options.task, f"a row from 0 to {len(suite) - 1}")
    return suite.initial(options.task, params), params


def _check(options: argparse.Namespace) -> int:
    print(f"{VERSION}, Python {platform.python_version()}, numpy {np.__version__}")
    params = SnakeParams()
    state = load_tasks("sim-1", params).initial(0, params)
    optimizer = AnalyticOptimizer(params)
    began = time.perf_counter()
    optimizer.select(state)
    print(
        f"kernel ready after {time.perf_counter() - began:.2f} s (cache: {cache_folder() or 'none'})"
    )
    began = time.perf_counter()
    repeats = 20
    for _ in range(repeats):
        optimizer.select(state)
    decision_ms = 1e3 * (time.perf_counter() - began) / repeats
    print(f"one decision of (21) over 99 modes: {decision_ms:.2f} ms")
    while not state.done and state.elapsed < params.horizon_s:
        state, _ = advance(state, optimizer.select(state).last_resort, params)
    solved = state.done and state.elapsed == _SIM_1_SECONDS
    print(f"sim-1 by (21): {state.elapsed:.0f} s, expected {_SIM_1_SECONDS:.0f} s")
    env = gymnasium.make("snake_env:SnakeModeSelection-v0")
    check_env(env.unwrapped, skip_render_check=True)
    print("gymnasium's check_env: passed")
    for module, extra in (
        *(("PIL", "render"), ("matplotlib", "render"), ("pygame", "render")),
        *(("joblib", "evaluate"), ("stable_baselines3", "train")),
    ):
        found = importlib.util.find_spec(module) is not None
        hint = "found" if found else f"not installed: pip install snake-mode-env[{extra}]"
        print(f"optional {module}: {hint}")
    print("all checks passed" if solved else "FAILED: sim-1 took a different time")
    return 0 if solved else 1


def _gif(options: argparse.Namespace) -> int:
    state, params = _begin(options)
    policy = load_policy(options.policy, params)
    policy.reset(options.task)
    folder = options.out.absolute().parent
    if not folder.is_dir() or options.out.suffix.lower() != ".gif":
        raise InvalidInputError("out", str(options.out), "a .gif file in a folder that exists")
    Painter(params)  # complains before the work if Pillow is missing
    scenes: list[Scene] = [still_scene(state, params)]
    episode = Episode(state, params)
    while not episode.outcome:
        mode = policy.select_mode(state)
        after, prediction = advance(state, mode, params)
        if not episode.take(state, after, prediction):
            break
        broken = "" if episode.outcome in ("", *_ENDS_AT_REST) else episode.outcome
        scenes += motion_scenes(state, mode, params, alarm=broken)
        state = after
    if episode.outcome in _ENDS_AT_REST:
        alarm = "" if episode.outcome == "success" else episode.outcome
        scenes.append(still_scene(state, params, alarm=alarm))
    print(f"drawing {len(scenes)} frames ...")
    try:
        save_gif(scenes, options.out, params)
    except (OSError, ValueError) as error:
        raise InvalidInputError(
            "out", str(options.out), f"a .gif file to write ({error})"
        ) from None
    ending = "target reached" if state.done else episode.outcome.replace("_", " ")
    print(f"{options.out}: {len(scenes)} frames, {ending} after {state.elapsed:.1f} s")
    return 0


def _play(options: argparse.Namespace) -> int:
    state, params = _begin(options)
    render_mode = "human" if options.window else None
    changes = parse_overrides(options.set)
    env = SnakeModeSelectionEnv(options.preset, render_mode=render_mode, **changes)
    env.reset(options={"phi0": state.phi, "target": state.target})
    optimizer = AnalyticOptimizer(params)
    print(_HELP)
    while True:
        state = env.state
        _describe(state)
        try:
            mode = _ask(state, optimizer)
        except EOFError:  # Ctrl-D
            print()
            return 0
        if mode is None:
            return 0
        _, reward, terminated, truncated, info = env.step(mode)
        wheels = ", ".join(str(k) for k in np.flatnonzero(info["lifted"]) + 1)
        print(f"mode {mode}: wheels {wheels} in the air, reward {reward:+.3f}")
        if terminated or truncated:
            summary = info["episode_summary"]
            print(f"{summary['outcome'].replace('_', ' ')} after {summary['time_s']:.1f} s")
            return 0


def _describe(state: SnakeState) -> None:
    def row(values: np.ndarray[tuple[int], np.dtype[np.float64]]) -> str:
        return " ".join(f"{value:+6.2f}" for value in values)

    print(f"\n{state.elapsed:.0f} s, phase {state.phase}")
    print(f"  joint  {' '.join(f'{k:6d}' for k in range(1, len(state.phi) + 1))}")
    print(f"  angle  {row(state.phi)}\n  target {row(state.target)}")


def _ask(state: SnakeState, optimizer: AnalyticOptimizer) -> int | None:
    """The player's choice; None to quit."""
    table = mode_table(optimizer.params.n_joints)
    while True:
        words = input("mode> ").split()
        try:
            if words in (["q"], ["quit"]):
                return None
            if words == ["a"]:
                choice = optimizer.select(state).mode
                print(f"mode {choice}: {_lifts(choice, table)}" if choice is not None else _NOTHING)
            elif words == ["l"]:
                _list_modes(optimizer.select(state), table)
            elif words[-1:] == ["up"]:
                return table.check(table.index(_integer(word) for word in words[:-1]), state.phase)
            elif len(words) == 1 and words != ["?"]:
                return table.check(_integer(words[0]), state.phase)
            else:
                print(_HELP)
        except SnakeEnvError as error:
            print(error)


def _list_modes(selection: Selection, table: ModeTable) -> None:
    prediction = selection.prediction
    for k in np.argsort(prediction.j, kind="stable")[:_LISTED]:
        if prediction.feasible[k]:
            mode = int(selection.modes[k])
            print(f"  mode {mode:3d}  J = {prediction.j[k]:9.4f}  {_lifts(mode, table)}")
    for violation, count in sorted(Counter(prediction.violation.tolist()).items()):
        what = f"break {violation.replace('_', ' ')}" if violation else "are feasible"
        print(f"  {count} of {len(selection.modes)} modes {what}")


def _integer(word: str) -> int:
    try:
        return int(word)
    except ValueError:
        raise InvalidInputError("mode", word, "a number; ? for help") from None


def _lifts(mode: int, table: ModeTable) -> str:
    wheels = [str(wheel) for wheel in table.wheels[mode] if wheel]
    return "lifts " + (", ".join(wheels) if wheels else "no rear wheel")


if __name__ == "__main__":
    interrupts.leave(main())
