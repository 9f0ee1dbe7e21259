"""Options of ``python -m evaluate``."""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from snake_env.errors import InvalidInputError, MissingDependencyError
from snake_env.params import SnakeParams

Assignments = tyro.conf.UseAppendAction[
    Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=VALUE")]
]


@dataclass(frozen=True)
class Options:
    """Run policies on the same tasks and compare them."""

    policies: Annotated[
        tuple[str, ...],
        tyro.conf.Positional,
        tyro.conf.arg(metavar="POLICY...", help_behavior_hint=""),
    ]
    """analytic, analytic-14, first-feasible, random or skid (all joints at once, wheels skidding)."""
    tasks: str = "paper-500"
    """paper-500, sim-1, random:N[:SEED], or FILE.npz with arrays phi0 and target of shape (N, n)."""
    preset: str = "paper"
    """Constants of the robot: paper, hardware or narrow."""
    set: Assignments = ()
    """Replaces a constant of the preset, for example --set a_c=67; may be repeated."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Folder for summary.json, episodes.csv and pictures; nothing is written without it."""
    overwrite: bool = False
    """Replace the results in --out."""
    resume: bool = False
    """Go on with the interrupted run in --out."""
    workers: int = -1
    """Processes; -1: one for each core."""
    engine: Literal["local", "ray"] = "local"
    """What runs the workers: processes of this machine, or a Ray cluster."""
    pictures: bool = True
    """Draw the pictures, too (needs --out)."""

    def check(self) -> SnakeParams:
        """The constants that the options ask for.

        Raises:
            SnakeEnvError: An option's value can't be used, or two options contradict each other.
        """
        if not self.policies:
            raise InvalidInputError("POLICY", self.policies, "at least one policy")
        for position, name in enumerate(self.policies):
            if name in self.policies[:position]:
                raise InvalidInputError("POLICY", name, "each policy once")
        if self.workers == 0 or self.workers < -1:
            expected = "a positive number, or -1 for all cores"
            raise InvalidInputError("workers", self.workers, expected)
        if self.out is None and (self.overwrite or self.resume):
            raise InvalidInputError("out", None, "a folder, to go with --overwrite or --resume")
        if self.overwrite and self.resume:
            raise InvalidInputError("overwrite", True, "one of --overwrite and --resume")
        if self.engine == "ray" and importlib.util.find_spec("ray") is None:
            raise MissingDependencyError("--engine ray needs Ray: pip install ray")
        return SnakeParams.preset(self.preset, **parse_overrides(self.set))


def parse_overrides(assignments: Iterable[str]) -> dict[str, Any]:
    """Constants from ``NAME=VALUE`` texts.

    Raises:
        InvalidInputError: A text has another form.
    """
    pairs = {}
    for assignment in assignments:
        name, equals, text = assignment.partition("=")
        try:
            pairs[name] = json.loads(text.lower())
        except ValueError:
            equals = ""
        if not equals:
            raise InvalidInputError(
                "set", assignment, "NAME=VALUE; a value is a number, a [list], true or false"
            )
    return pairs
