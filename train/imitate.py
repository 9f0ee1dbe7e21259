"""``python -m train imitate``: a policy network, from a teacher's costs of every mode."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
import tyro
from rich.console import Console

from agents.checks import check_positive, check_share
from agents.imitate import Fit, Lessons, fit, lessons, lessons_of, read_lessons
from agents.teacher import Visit, collect
from harness.engine import Engine
from harness.progress import progress
from harness.provenance import command
from harness.robot import Robot
from snake_env.errors import InvalidInputError
from snake_env.networks.model_file import Model, read_model, read_network, write_model
from snake_env.networks.network import Network
from snake_env.params import SnakeParams
from snake_env.policies.value import GUIDES, pretrained, value_digest
from snake_env.policies.warm_up import warm_up
from snake_env.sim.observation import observation_size
from train.run import Run, RunFolder
from train.validation import Validation, quality

_PART = 2048  # decisions that a worker collects at a time
_ROUNDS = ("rounds", "decisions", "depth", "overweight", "near_limits")  # how they are collected


@dataclass(frozen=True)
class Options:
    """Learn which mode is cheap from a teacher that knows what each would cost (DAgger).

    Round by round the student plays random tasks, the teacher judges every mode of the states on the
    way, and the student is fitted to all judgements so far.
    """

    run: Run = field(default_factory=Run)
    robot: Robot = field(default_factory=Robot)
    engine: Engine = field(default_factory=Engine)
    fit: Fit = field(default_factory=Fit)
    validation: Validation = field(default_factory=Validation)
    init: Path | None = None
    """Model file of the student that plays first, and begins with its weights where it has these hidden
    layers; {seed} stands for the run's seed. Default: the teacher plays first."""
    value: Path | None = None
    """Model file of the value network that the teacher trusts; {seed} stands for the run's seed.
    Default: what ships for these robots, else the potential of the reward."""
    lessons: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="RUN...")] = ()
    """Also learn from the judgements of other runs; with --rounds 0 from these only. {seed} stands for
    the run's seed."""
    rounds: int = 5
    """Rounds of playing and fitting."""
    decisions: int = 262_144
    """Decisions that are judged in each round, in parts of 2048."""
    depth: int = 0
    """Intervals that the teacher searches beyond a mode's end, before it takes the value."""
    overweight: float = 4.0
    """Keep states in which the student's choice is infeasible so many times as often as others; the
    first round, in which the teacher plays, keeps all."""
    near_limits: float = 0.0
    """Share of the episodes in which a joint begins within 0.05 rad of its limit: rare in random tasks,
    and most of what a student does wrong in phase 1."""

    def check(self) -> SnakeParams:
        """The constants that the options ask for.

        Raises:
            SnakeEnvError: An option's value can't be used.
        """
        check_positive(self, "decisions")
        if self.rounds < (0 if self.lessons else 1):
            raise InvalidInputError("rounds", self.rounds, "a positive number, or 0 with --lessons")
        if self.depth < 0:
            raise InvalidInputError("depth", self.depth, "zero or a positive number")
        check_share(self, "near_limits")
        if not self.overweight >= 1.0:
            raise InvalidInputError("overweight", self.overweight, "at least 1")
        self.fit.check()
        self.validation.check()
        self.engine.check()
        return self.robot.params()


def train(options: Options, console: Console) -> Path:
    """Runs all rounds, or those that an interrupted run has left.

    A round depends on the run's seed, its own number, the network before it and the
    judgements so far.

    Returns:
        The best model's file.
    """
    params = options.check()
    init = None if options.init is None else options.run.own(options.init)
    accept = {"transfer": options.robot.transfer}
    begun = None if init is None else read_network(init, params, "policy", **accept)
    trusted = None
    if options.value is not None:
        trusted = read_model(options.run.own(options.value))
    elif options.robot.transfer:
        trusted = pretrained(params, *GUIDES, transfer=True)
    if trusted is not None:
        trusted.check(params, "value", **accept)
    taught = [options.run.own(run) for run in options.lessons]
    given = [lesson for run in taught for lesson in _given(run, params)]
    config = {
        **dataclasses.asdict(options.fit),
        **{key: getattr(options, key) for key in _ROUNDS},
        **dataclasses.asdict(options.validation),
        "value": value_digest(params) if trusted is None else trusted.sha256,
        "init": None if init is None else str(init),
        "lessons": list(map(str, taught)),
        "seed": options.run.seed,
        "params": dataclasses.asdict(params),
    }
    with RunFolder(options.run, "imitate", options.robot, config) as folder:
        rows: list[dict[str, Any]] = list(folder.rows("round"))
        finished = len(rows) >= max(1, options.rounds)
        sizes = [observation_size(params.n_joints), *options.fit.hidden]
        network = begun if begun is not None and begun.sizes[:-1] == sizes else None
        if rows:
            network = read_model(_kept(folder.path, len(rows) - 1)).network
        torch.set_num_threads(1)
        warm_up(params)
        last = max(0, options.rounds - 1)
        for number in range(len(rows), last + 1):
            label = f"round {number + 1} of {last + 1}"
            if options.rounds > 0:
                student = network or begun
                value = None if trusted is None else trusted.network
                visits = _visits(options, number, student, value, params)
                _play(options, visits, number, params, folder.path, label, console)
            network, figures = fit(
                network,
                [*given, *read_lessons(folder.path)],
                options.fit,
                params.n_joints,
                seed=options.run.seed + 1000 * number,
                last=number == last,
            )
            kept = _kept(folder.path, number)
            made = {"command": command(), "config": config, "round": number + 1}
            write_model(kept, Model("policy", params, network, made))
            row: dict[str, Any] = {"round": number + 1}
            row |= {key: round(value, 5) for key, value in figures.items()}
            row |= options.validation(kept, params)
            validated = Model("policy", params, network, {**made, "validation": row})
            write_model(folder.path / "last.safetensors", validated)
            if not rows or quality(row) > max(map(quality, rows)):
                write_model(folder.path / "best.safetensors", validated)
            rows.append(row)
            folder.write_rows(rows)
            _kept(folder.path, number - 1).unlink(missing_ok=True)
            console.print(
                f"{label}: regret {row['regret']:.3f}, infeasible {row['infeasible']:.2%}; "
                f"raw {row['raw_success']:.1%} in {row['raw_time_s']:.1f} s, "
                f"shielded {row['shielded_success']:.1%} in {row['shielded_time_s']:.1f} s",
                soft_wrap=True,
            )
        if finished:
            console.print("this run is finished")
        console.print(f"best model: {folder.path / 'best.safetensors'}", soft_wrap=True)
        return folder.path / "best.safetensors"


def _visits(
    options: Options,
    number: int,
    student: Network | None,
    value: Network | None,
    params: SnakeParams,
) -> list[Visit]:
    """What is to be collected in a round."""
    count = -(-options.decisions // _PART)
    return [
        Visit(
            seed=options.run.seed,
            part=number * count + part,
            decisions=_PART,
            teacher="lookahead",
            depth=options.depth,
            value=value,
            student=student,
            overweight=1.0 if student is None else options.overweight,
            mirrored=False,
            near_limits=options.near_limits,
            params=params,
        )
        for part in range(count)
    ]


def _play(
    options: Options,
    visits: list[Visit],
    number: int,
    params: SnakeParams,
    folder: Path,
    label: str,
    console: Console,
) -> None:
    """Collects a round's lessons and keeps them."""
    collected = []
    with progress(console, len(visits) * _PART, "decisions") as advance:
        for part, decisions in options.engine.map(collect, visits):
            collected.append((part, lessons(decisions, params)))
            advance(label, _PART)
    collected.sort(key=lambda pair: pair[0])
    np.savez(
        _lessons(folder, number),
        observations=np.concatenate([lesson.observations for _, lesson in collected]),
        cost=np.concatenate([lesson.cost for _, lesson in collected]),
    )


def _kept(path: Path, number: int) -> Path:
    return path / f"round-{number}.safetensors"


def _lessons(path: Path, number: int) -> Path:
    return path / f"lessons-{number}.npz"


def _given(run: Path, params: SnakeParams) -> list[Lessons]:
    """The lessons of another run.

    Raises:
        InvalidInputError: There are none, or they are those of other robots.
    """
    parts = lessons_of(run)
    if parts[0].observations.shape[1] != observation_size(params.n_joints):
        raise InvalidInputError("lessons", str(run), f"those of {params.n_joints} joints")
    return parts
