"""Command line: ``python -m train ALGO [options]``."""

from __future__ import annotations

import importlib
import sys
from typing import Any

from harness.command import complain, exit_code
from harness.command import console as make_console
from harness.engine import WorkerLostError
from harness.provenance import begin
from snake_env import VERSION, interrupts
from snake_env.errors import UnknownNameError
from train.config import parse_with_file
from train.run import Run

COMMANDS = {
    "value": "the cost-to-go network that guides the planner",
    "imitate": "a policy network, from a teacher's costs of every mode",
    "ppo": "a policy by proximal policy optimisation",
    "dqn": "action values by deep Q-learning",
    "harvest": "tasks that a policy loses to wrong choices, to learn from",
    "recipe": "all of these in a row, from random weights",
    "export": "ship the best model of a run with the package",
}
"""What can be trained or made; each is a module of this package with ``Options`` and ``train``."""


def main(args: list[str] | None = None) -> int:
    """Runs the command; its exit code."""
    words = sys.argv[1:] if args is None else args
    return exit_code(lambda: _command(words), "interrupted: what is finished is kept")


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
        options = parse_with_file(module.Options, f"python -m train {words[0]}", words[1:])
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
    lines = [f"  {name:10} {what}" for name, what in COMMANDS.items()]
    return "\n".join(
        ["usage: python -m train COMMAND [options]", "", *lines, "", "COMMAND --help tells more."]
    )


if __name__ == "__main__":
    interrupts.leave(main())
