"""``python -m train collect``: a teacher's decisions, with the cost-to-go of every mode."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from agents.teacher import Teacher, Visit, collect
from agents.teacher_data import MANIFEST, SCHEMA, read_manifest, read_shard, shard_path, to_bytes
from evaluate.engine import Engine
from evaluate.journal import writable_folder, write_atomically
from evaluate.progress import progress
from snake_env.errors import InvalidInputError
from snake_env.model_file import Model, read_model
from snake_env.params import SnakeParams
from snake_env.programs import warm_up
from train.run import Robot, command, value_digest

SHARD = 2048
"""Decisions in a shard."""


@dataclass(frozen=True)
class Options:
    """Ask a teacher what every feasible mode would cost, in states along random tasks."""

    robot: Robot = field(default_factory=Robot)
    engine: Engine = field(default_factory=Engine)
    teacher: Teacher = "lookahead"
    """lookahead: search, then the value network; analytic: (21) played to the end from every mode."""
    decisions: int = 100_000
    """States to judge, in whole shards of 2048; mirrored copies come on top."""
    depth: int = 0
    """Intervals that the teacher lookahead searches beyond a mode's end, before it takes the value."""
    student: Annotated[Path | None, tyro.conf.arg(metavar="MODEL")] = None
    """Visit the states that this policy's network leads to (DAgger); default: the teacher's."""
    overweight: float = 1.0
    """Keep states near a deadlock (at most 3 feasible modes) so many times as often as others."""
    mirror: bool = False
    """Add the mirror image of every decision."""
    seed: int = 0
    """Seed of the random tasks and of the exploration."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Folder for the shards; default: runs/collect- and the teacher."""

    def check(self) -> SnakeParams:
        """The constants that the options ask for.

        Raises:
            SnakeEnvError: An option's value can't be used.
        """
        for name, least in (("decisions", 1), ("depth", 0), ("seed", 0), ("overweight", 1)):
            if not getattr(self, name) >= least:
                raise InvalidInputError(name, getattr(self, name), f"at least {least}")
        return self.robot.params()


def train(options: Options, console: Console) -> None:
    """Makes the shards that the folder lacks: a killed run is completed by the same command.

    A shard depends on its number, the seed and the other options only. Asking for more decisions adds
    shards to those that are there.
    """
    params = options.check()
    folder = options.out or Path("runs") / f"collect-{options.teacher}"
    student = None if options.student is None else _student(options.student, params)
    about = {
        "schema": SCHEMA,
        "teacher": options.teacher,
        "depth": options.depth,
        "student": None if student is None else student.sha256,
        "value": value_digest(params),
        "overweight": options.overweight,
        "mirror": options.mirror,
        "seed": options.seed,
        "params": json.loads(json.dumps(asdict(params))),
    }
    options.engine.check()
    _claim(folder, about)
    parts = range(-(-options.decisions // SHARD))
    for part in parts:
        if shard_path(folder, part).exists():
            read_shard(shard_path(folder, part))  # a damaged one is reported before any work
    missing = [
        Visit(
            seed=options.seed,
            part=part,
            decisions=SHARD,
            teacher=options.teacher,
            depth=options.depth,
            value=None,
            student=None if student is None else student.network,
            overweight=options.overweight,
            mirrored=options.mirror,
            near_limits=0.0,
            params=params,
        )
        for part in parts
        if not shard_path(folder, part).exists()
    ]
    warm_up(params)
    try:
        with progress(console, len(missing) * SHARD, "decisions") as advance:
            for part, decisions in options.engine.map(collect, missing):
                write_atomically(shard_path(folder, part), to_bytes(decisions))
                advance("collect", SHARD)
    except KeyboardInterrupt:
        done = sum(shard_path(folder, part).exists() for part in parts)
        console.print(f"{done} of {len(parts)} shards are in {folder}", soft_wrap=True)
        raise
    console.print(f"{len(parts) * SHARD} decisions: {folder}", soft_wrap=True)


def _student(path: Path, params: SnakeParams) -> Model:
    model = read_model(path)
    if model.kind != "policy":
        raise InvalidInputError("student", str(path), "the model of a policy")
    model.check(params, "policy")
    return model


def _claim(folder: Path, about: dict[str, object]) -> None:
    """Makes the folder, or checks that it is of the same data."""
    if (folder / MANIFEST).exists():
        there = read_manifest(folder)
        differing = sorted(key for key in about if there.get(key) != about[key])
        if differing:
            expected = f"a folder made with the same options (these differ: {', '.join(differing)})"
            raise InvalidInputError("out", str(folder), expected)
        return
    if folder.is_dir() and any(folder.iterdir()):
        raise InvalidInputError("out", str(folder), "an empty folder, or one of teacher data")
    writable_folder(folder)
    text = json.dumps({**about, "command": command()}, indent=1) + "\n"
    write_atomically(folder / MANIFEST, text)
