"""Options of ``python -m evaluate``."""

from __future__ import annotations

import shlex
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from evaluate.deadline import check_limit
from evaluate.outside import is_outside
from evaluate.table import Format
from harness.engine import Engine
from harness.options import Assignments
from snake_env.errors import InvalidInputError, escaped
from snake_env.params import SnakeParams, parse_overrides
from snake_env.sim.slip import NO_SLIP, check_slip

Factories = tyro.conf.UseAppendAction[
    Annotated[tuple[str, ...], tyro.conf.arg(metavar="MODULE:FACTORY")]
]


@dataclass(frozen=True)
class Options:
    """Run policies on the same tasks and compare them.

    Finished runs: python -m evaluate compare --help. Shortest plans: python -m evaluate solve --help.
    """

    policies: Annotated[
        tuple[str, ...],
        tyro.conf.Positional,
        tyro.conf.arg(metavar="POLICY...", help_behavior_hint=""),
    ]
    """Names (analytic, analytic-14, first-feasible, lookahead, value, imitate, ppo, dqn, random, skid),
    model files, or run folders of python -m train. +shield simulates each choice before it is executed,
    +critic simulates the eight preferred modes. Options follow a colon: lookahead:width=16. The first
    policy is the baseline."""
    policy: Factories = ()
    """Your own policy; the factory is called with the robot's constants. May be repeated."""
    tasks: str = "paper-500"
    """paper-500, validation-2k, test-2k, test-10k, sim-1, random:N[:SEED], or FILE.npz with arrays phi0
    and target of shape (N, n)."""
    preset: str = "paper"
    """Constants of the robot: paper, hardware, narrow, six or ten."""
    set: Assignments = ()
    """Replaces a constant of the preset, for example --set a_c=67; may be repeated."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Folder for report.html, summary.json, episodes.csv and pictures. Default: only print."""
    overwrite: bool = False
    """Replace the results in --out."""
    resume: bool = False
    """Continue the interrupted run in --out."""
    decision_timeout: Annotated[float | None, tyro.conf.arg(metavar="SECONDS")] = None
    """Time limit for a decision. A slower one ends the episode with the outcome error."""
    slip: tuple[float, float] = NO_SLIP
    """Wheel slip (section VI): standard deviations of the head's position [m] and heading [rad] per
    interval, for example 0.002 0.01. Every policy gets the same samples."""
    no_latency: bool = False
    """Do not time decisions. summary.json is then the same, byte for byte, in repeated runs."""
    no_pictures: bool = False
    """Only write summary.json and episodes.csv."""
    video: Annotated[str, tyro.conf.arg(metavar="TASK,...|default")] = ""
    """Write videos of these tasks: numbers or sim-1, separated by commas, or the word default (sim-1,
    the median and the slowest task). Each shows the first policy beside the fastest other one. MP4 with
    the extra video, else GIF."""
    format: Format = "text"
    """Format of the tables: text, md (Markdown), latex or csv. The last three print nothing else."""
    engine: Engine = field(default_factory=Engine)

    @property
    def names(self) -> tuple[str, ...]:
        """All policies: the first is the baseline."""
        return (*self.policies, *self.policy)

    @property
    def command(self) -> str:
        """The command, without what has no influence on results."""
        words = [*self.policies, *(word for name in self.policy for word in ("--policy", name))]
        words += ["--tasks", self.tasks, "--preset", self.preset]
        words += [word for assignment in self.set for word in ("--set", assignment)]
        if any(self.slip):
            words += ["--slip", *map(str, self.slip)]
        if self.decision_timeout is not None:
            words += ["--decision-timeout", str(self.decision_timeout)]
        return shlex.join(["python", "-m", "evaluate", *words])

    def check(self) -> SnakeParams:
        """The constants that the options ask for.

        Raises:
            SnakeEnvError: An option's value can't be used, or two options contradict each other.
        """
        if not self.names:
            raise InvalidInputError("POLICY", self.names, "at least one policy")
        for option, name in [("tasks", self.tasks), *(("POLICY", name) for name in self.names)]:
            if escaped(name) != name or "\n" in name:
                raise InvalidInputError(option, name, "a name without control characters")
        for position, name in enumerate(self.names):
            if name in self.names[:position]:
                raise InvalidInputError("POLICY", name, "each policy once")
        for name in self.policies:
            if is_outside(name):
                raise InvalidInputError("POLICY", name, "--policy before MODULE:FACTORY")
        for name in self.policy:
            if not is_outside(name):
                expected = "MODULE:FACTORY, and a module that is not named like a policy"
                raise InvalidInputError("policy", name, expected)
        check_slip(self.slip)
        if self.decision_timeout is not None:
            check_limit(self.decision_timeout)
        if self.out is None and (self.overwrite or self.resume):
            raise InvalidInputError("out", None, "a folder, to go with --overwrite or --resume")
        if self.out is None and self.video:
            raise InvalidInputError("out", None, "a folder, to go with --video")
        if self.overwrite and self.resume:
            raise InvalidInputError("overwrite", True, "one of --overwrite and --resume")
        params = SnakeParams.preset(self.preset, **parse_overrides(self.set))
        self.engine.check()
        return params
