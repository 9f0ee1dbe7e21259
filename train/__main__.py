"""Command line: ``python -m train ALGO [options]``."""

from __future__ import annotations

import importlib
import sys
from typing import Any

from harness.console import console as make_console
from harness.engine import WorkerLostError
from harness.provenance import begin
from snake_env import VERSION
from snake_env.errors import UnknownNameError
from snake_env.system import interrupts
from snake_env.system.exit_code import complain, exit_code
from train.config import parse_with_file
from train.run import Run

GROUPS = {
    "everything for a robot": {
        "recipe": "all stages for one robot (start here)",
    },
    "stages": {
        "value": "a value network: teacher, critic, and guide of the planner",
        "ppo": "a policy by PPO, from scratch or from a student",
        "dqn": "a policy by DQN, from scratch or from a student",
        "imitate": "a student, by imitation of one-step lookahead with a value network",
    },
    "tools": {
        "export": "copy the models of a recipe or a run into the package",
    },
}
"""What can be trained or made, by what it is for."""
COMMANDS = {name: what for group in GROUPS.values() for name, what in group.items()}
"""Each is a module of this package with ``Options`` and ``train``."""


def main(args: list[str] | None = None) -> int:
    """Runs the command; its exit code."""
    words = sys.argv[1:] if args is None else args
    return exit_code(lambda: _command(words), "interrupted; finished work is saved")


def _command(words: list[str]) -> int:
    try:
        if not words or words[0] in ("-h", "--help"):
            print(_help())
            return 0 if words else 2
        if words == ["--version"]:
            print(VERSION)
            return 0
        if words[0] not in COMMANDS:
            raise UnknownNameError("command", words[0], COMMANDS)
        begin("python -m train", words)
        module: Any = importlib.import_module(f"train.{words[0]}")
        options = parse_with_file(module.Options, words[0], words[1:])
        console = make_console()
        run = getattr(options, "run", None)
        if isinstance(run, Run) and run.seeds != 1:
            from train.seeds import train_seeds  # takes a while to import

            train_seeds(words[0], options, words, console)
        else:
            module.train(options, console)
    except WorkerLostError as error:
        complain(f"error: {error}; --resume continues from what is finished")
        return 1
    return 0


def _help() -> str:
    lines = ["usage: python -m train COMMAND [options]"]
    for title, group in GROUPS.items():
        lines += ["", f"{title}:", *(f"  {name:8} {what}" for name, what in group.items())]
    return "\n".join([*lines, "", "python -m train COMMAND --help lists a command's options."])


if __name__ == "__main__":
    interrupts.leave(main())
