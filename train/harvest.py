"""``python -m train harvest``: tasks that a policy loses, to learn from."""

from __future__ import annotations

import io
import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from rich.console import Console

from agents.checks import check_positive, check_share
from agents.harvest import Lost, Trial, around, play
from harness.engine import Engine
from harness.files import write_atomically
from harness.folder import Found, Layout, held
from harness.journal import Journal, check_finished
from harness.progress import progress
from harness.provenance import command
from harness.robot import Robot
from snake_env.errors import InvalidInputError
from snake_env.networks.model_file import Model, read_model
from snake_env.params import SnakeParams
from snake_env.sim.tasks import random_tasks
from snake_env.sim.warm_up import warm_up
from train.ground import Ground

_PART = 512  # tasks that a worker plays side by side
_OTHERS = (0, 3)  # spawn key of the random numbers that no shard has


LAYOUT = Layout(begun="lost.partial.jsonl", done="harvest.json", own=("tasks.npz",))
"""What the folder of a harvest holds."""


@dataclass(frozen=True)
class Options:
    """Play random tasks; keep those that a policy loses to choices that a one-step check rejects.

    These, others close to them and random ones are a suite for train ppo and dqn --tasks.
    """

    robot: Robot = field(default_factory=Robot)
    engine: Engine = field(default_factory=Engine)
    ground: Ground = field(default_factory=Ground)
    policy: Annotated[Path | None, tyro.conf.arg(metavar="MODEL")] = None
    """Model file of the policy."""
    tasks: int = 1_000_000
    """Random tasks to play, in whole shards of 512."""
    copies: int = 6
    """Tasks close to each lost one that are kept as well."""
    spread: float = 0.03
    """Standard deviation of each joint's change in these [rad]."""
    share: float = 0.4
    """Share of lost tasks and those around them in what is written; the others are random ones."""
    seed: int = 0
    """Seed of the random tasks."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Folder for tasks.npz; default: runs/harvest- and the robot."""
    resume: bool = False
    """Continue the interrupted harvest in the folder."""
    overwrite: bool = False
    """Replace the harvest in the folder."""

    def check(self) -> SnakeParams:
        """The constants that the options ask for.

        Raises:
            SnakeEnvError: An option's value can't be used.
        """
        check_positive(self, "tasks", "spread", "share")
        check_share(self, "share")
        for name in ("copies", "seed"):
            if getattr(self, name) < 0:
                raise InvalidInputError(name, getattr(self, name), "zero or a positive number")
        self.ground.check()
        if self.policy is None:
            raise InvalidInputError("policy", None, "--policy: whose lost tasks are wanted")
        if self.overwrite and self.resume:
            raise InvalidInputError("overwrite", True, "one of --overwrite and --resume")
        return self.robot.params()


def train(options: Options, console: Console) -> Path:
    """Plays all shards, or those that an interrupted harvest has left; writes the suite of tasks.

    A shard depends on its number, the seed and the policy only: not on the workers.

    Returns:
        The suite's file.
    """
    params = options.check()
    assert options.policy is not None
    model = read_model(options.policy)
    model.check(params, "policy", transfer=options.robot.transfer)
    folder = options.out or Path("runs") / f"harvest-{options.robot.name}"
    options.engine.check()
    config = {
        "policy": model.sha256,
        "seed": options.seed,
        "slip": list(options.ground.slip),
        "params": json.loads(json.dumps(asdict(params))),
    }
    flags = {"overwrite": options.overwrite, "resume": options.resume}
    with held(folder, LAYOUT, **flags) as found:
        return _harvest(options, params, model, config, folder, found, console)


def _harvest(
    options: Options,
    params: SnakeParams,
    model: Model,
    config: dict[str, Any],
    folder: Path,
    found: Found,
    console: Console,
) -> Path:
    file = folder / "tasks.npz"
    chosen = {name: getattr(options, name) for name in ("tasks", "copies", "spread", "share")}
    if found == "finished":
        check_finished(folder / LAYOUT.done, {**config, **chosen})
        console.print(f"this harvest is finished: {file}", soft_wrap=True)
        return file
    lost: dict[int, Lost] = {}

    def take(entry: Any) -> None:
        shapes = (np.array(entry[name], dtype=np.float64) for name in ("phi0", "target"))
        phi0, target = (each.reshape(-1, params.n_joints) for each in shapes)
        if type(entry["part"]) is not int or entry["part"] < 0 or phi0.shape != target.shape:
            raise ValueError("no part of a harvest")
        if not (np.abs(phi0) <= np.pi).all() or not (np.abs(target) <= np.pi).all():
            raise ValueError("no shapes")
        lost[entry["part"]] = Lost(entry["part"], phi0, target)

    journal = Journal(folder / LAYOUT.begun, config, resume=found == "begun", take=take)
    count = -(-options.tasks // _PART)
    shards = [
        Trial(options.seed, part, _PART, model.network, params, options.ground.slip)
        for part in range(count)
        if part not in lost
    ]
    warm_up(params)
    with progress(console, len(shards) * _PART, "tasks") as advance:
        for part in options.engine.map(play, shards):
            lost[part.part] = part
            shapes = {"phi0": part.phi0.tolist(), "target": part.target.tolist()}
            journal.append({"part": part.part, **shapes})
            advance("harvest", _PART)
    parts = [lost[part] for part in range(count) if len(lost[part].phi0)]
    if not parts:
        raise InvalidInputError("tasks", options.tasks, "more: none of these was lost")
    rng = np.random.default_rng(np.random.SeedSequence(options.seed, spawn_key=_OTHERS))
    phi0, target = around(
        np.concatenate([part.phi0 for part in parts]),
        np.concatenate([part.target for part in parts]),
        options.copies,
        options.spread,
        rng,
        params,
    )
    others = random_tasks(rng.spawn(round(len(phi0) * (1.0 / options.share - 1.0))), params)
    content = io.BytesIO()
    np.savez(
        content,
        phi0=np.concatenate([phi0, others[0]]),
        target=np.concatenate([target, others[1]]),
    )
    write_atomically(file, content.getvalue())
    about = {
        "command": command(),
        **config,
        **chosen,
        "lost": sum(len(part.phi0) for part in parts),
    }
    write_atomically(folder / LAYOUT.done, json.dumps(about, indent=1) + "\n")
    journal.remove()
    console.print(
        f"{about['lost']} of {count * _PART} tasks were lost; "
        f"{len(phi0)} of these and around them, and {len(others[0])} random ones: {file}",
        soft_wrap=True,
    )
    return file
