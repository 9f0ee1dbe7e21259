"""``python -m train imitate``: a policy network, from a teacher's costs of every mode."""

from __future__ import annotations

import dataclasses
import functools
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from rich.console import Console

from agents.checks import check_positive
from agents.imitate import Fit, dataset, fit, read_datasets
from agents.teacher import Visit, collect
from harness.engine import Engine
from harness.progress import progress, tracked
from harness.provenance import command
from harness.robot import Robot
from snake_env.errors import InvalidInputError
from snake_env.networks.model_file import Model, read_model, write_model
from snake_env.networks.network import Network
from snake_env.params import SnakeParams
from snake_env.sim.warm_up import warm_up
from train.ground import Ground
from train.initial_models import read_checked
from train.run import Run, RunFolder, part_seed
from train.validation import Validation, in_words, quality

_PART = 2048  # decisions that a worker collects at a time
_ROUNDS = ("rounds", "decisions", "oversampling")  # how they are collected


@dataclass(frozen=True)
class Options:
    """Imitate a teacher that computes the cost of every mode (DAgger).

    Round by round the student plays random tasks, the teacher labels the modes of the states on the
    way, and the student is fitted to all labels so far.
    """

    value: Path
    """Model file of the teacher's value network, as train value writes it; {seed} is replaced by the
    run's seed. It is stored in the model and used by +critic."""
    run: Run = field(default_factory=Run)
    robot: Robot = field(default_factory=Robot)
    engine: Engine = field(default_factory=Engine)
    ground: Ground = field(default_factory=Ground)
    fit: Fit = field(default_factory=Fit)
    validation: Validation = field(default_factory=Validation)
    rounds: int = 4
    """Rounds of playing and fitting."""
    decisions: int = 131_072
    """Decisions that are labelled in each round, in parts of 2048."""
    oversampling: float = 16.0
    """Oversampling factor of states in which the student's choice is infeasible. The first round, in
    which the teacher plays, keeps all states."""

    def check(self) -> SnakeParams:
        """The constants that the options ask for.

        Raises:
            SnakeEnvError: An option's value can't be used.
        """
        check_positive(self, "rounds", "decisions")
        if not self.oversampling >= 1.0:
            raise InvalidInputError("oversampling", self.oversampling, "at least 1")
        self.fit.check()
        self.ground.check()
        self.validation.check()
        self.engine.check()
        return self.robot.params()


def train(options: Options, console: Console) -> Path:
    """Runs all rounds, or those that an interrupted run has left.

    A round depends on the run's seed, its own number, the network before it and the
    labels so far.

    Returns:
        The best model's file.
    """
    params, transfer = options.check(), options.robot.transfer
    value = read_checked(options.run.own(options.value), params, "value", transfer=transfer)
    config = {
        **dataclasses.asdict(options.fit),
        **{key: getattr(options, key) for key in _ROUNDS},
        **dataclasses.asdict(options.validation),
        "value": value.sha256,
        "slip": options.ground.slip,
        "seed": options.run.seed,
        "params": dataclasses.asdict(params),
    }
    with RunFolder(options.run, "imitate", options.robot, config) as folder:
        rows: list[dict[str, Any]] = list(folder.rows("round"))
        finished = len(rows) >= options.rounds
        network = read_model(_kept(folder.path, len(rows) - 1)).network if rows else None
        torch.set_num_threads(1)
        warm_up(params)
        for number in range(len(rows), options.rounds):
            label = f"round {number + 1} of {options.rounds}"
            visits = _visits(options, number, network, value.network, params)
            _play(options, visits, number, params, folder.path, label, console)
            network, figures = fit(
                network,
                read_datasets(folder.path),
                options.fit,
                params,
                seed=part_seed(options.run.seed, number),
                last=number == options.rounds - 1,
                track=functools.partial(tracked, console, label, "batches"),
            )
            kept = _kept(folder.path, number)
            made = {"command": command(), "config": config, "round": number + 1}
            kept_model = Model("policy", params, network, made, value, "both", action_values=True)
            write_model(kept, kept_model)
            row: dict[str, Any] = {"round": number + 1}
            row |= {key: round(value, 5) for key, value in figures.items()}
            row |= options.validation(kept, params, options.ground.slip)
            validated = dataclasses.replace(kept_model, made={**made, "validation": row})
            write_model(folder.path / "last.safetensors", validated)
            if not rows or quality(row) > max(map(quality, rows)):
                write_model(folder.path / "best.safetensors", validated)
            rows.append(row)
            folder.write_rows(rows)
            _kept(folder.path, number - 1).unlink(missing_ok=True)
            console.print(
                f"{label}: regret {row['regret']:.3f}, infeasible {row['infeasible']:.2%}; "
                f"{in_words(row)}",
                soft_wrap=True,
            )
        for labels in folder.path.glob("labels-*.npz"):  # hundreds of megabytes
            labels.unlink()
        if finished:
            console.print("this run is finished")
        console.print(f"best model: {folder.path / 'best.safetensors'}", soft_wrap=True)
        return folder.path / "best.safetensors"


def _visits(
    options: Options,
    number: int,
    student: Network | None,
    value: Network,
    params: SnakeParams,
) -> list[Visit]:
    """What is to be collected in a round."""
    count = -(-options.decisions // _PART)
    return [
        Visit(
            seed=options.run.seed,
            part=number * count + part,
            decisions=_PART,
            value=value,
            student=student,
            oversampling=1.0 if student is None else options.oversampling,
            params=params,
            slip=options.ground.slip,
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
    """Collects a round's dataset and saves it."""
    collected = []
    with progress(console, len(visits) * _PART, "decisions") as advance:
        for part, decisions in options.engine.map(collect, visits):
            collected.append((part, dataset(decisions, params)))
            advance(label, _PART)
    collected.sort(key=lambda pair: pair[0])
    np.savez(
        _labels_file(folder, number),
        observations=np.concatenate([part.observations for _, part in collected]),
        cost=np.concatenate([part.cost for _, part in collected]),
    )


def _kept(path: Path, number: int) -> Path:
    return path / f"round-{number}.safetensors"


def _labels_file(path: Path, number: int) -> Path:
    return path / f"labels-{number}.npz"
