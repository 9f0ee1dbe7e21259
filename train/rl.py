"""The training loop of PPO and DQN.

A run is a series of segments. At the beginning of each, every source of random numbers is seeded from
the run's seed and the segment's number, and the robots begin new episodes. At its end the whole state
is saved. So a run that was killed and resumed equals one that was not, to the bit.
"""

from __future__ import annotations

import dataclasses
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from rich.console import Console
from torch.utils.tensorboard import SummaryWriter

from agents.checks import check_device, check_positive
from agents.dqn import DQNLearner
from agents.learner import Learner, segment_seed
from agents.ppo import PPOLearner
from harness.options import Assignments
from harness.progress import progress
from harness.provenance import command
from harness.robot import Robot
from snake_env.envs.reward import RewardWeights
from snake_env.errors import InvalidInputError, UnknownNameError
from snake_env.networks.model_file import Model, write_model
from snake_env.params import parse_overrides
from snake_env.sb3 import SnakeVecEnv
from snake_env.sim.tasks import FROZEN, load_tasks
from snake_env.sim.warm_up import warm_up
from train.checkpoint import bad_checkpoint, check_counters, load_checkpoint, save_checkpoint
from train.given import read_checked
from train.ground import Ground
from train.run import Run, RunFolder
from train.validation import Validation, in_words, quality
from train.watch import Watch, stopping


@dataclass(frozen=True)
class Loop:
    """How the run goes."""

    init: Path | None = None
    """Model file to begin with, as train imitate makes it; {seed} stands for the run's seed. Default:
    random weights."""
    critic: Path | None = None
    """Model file of the value network by which +critic ranks what the policy's favourites lead to; it
    becomes part of the model. Default: what PPO's critic learns, or DQN's action values."""
    reward: Assignments = ()
    """Replaces a weight of the reward, for example --reward time=-0.05; may be repeated."""
    tasks: str | None = None
    """Suite of tasks to learn from, as in python -m evaluate --tasks; default: random tasks without
    end."""
    segment: int = 131_072
    """Decisions between two checkpoints."""
    validate_every: int = 4
    """Segments between two validations."""
    device: str = "cpu"
    """Where the networks learn: cpu, or cuda."""

    def check(self) -> dict[str, float]:
        """The reward's weights.

        Raises:
            SnakeEnvError: An option's value can't be used.
        """
        check_positive(self, "segment", "validate_every")
        check_device(self.device)
        if self.tasks in FROZEN:
            raise InvalidInputError("tasks", self.tasks, "others: agents are compared on these")
        known = [weight.name for weight in dataclasses.fields(RewardWeights)]
        given = parse_overrides(self.reward)
        for name in given:
            if name not in known:
                raise UnknownNameError("reward term", name, known)
        return {**dataclasses.asdict(RewardWeights()), **given}


def train(
    make: type[PPOLearner] | type[DQNLearner],
    settings: Any,
    run: Run,
    robot: Robot,
    loop: Loop,
    ground: Ground,
    validation: Validation,
    console: Console,
    *,
    init_critic: Path | None = None,
) -> Path:
    """Trains to the end, or from where an interrupted run is.

    Args:
        make: The learner.
        settings: Its ``Settings``.
        run: Where the run is kept.
        robot: The robot's constants.
        loop: How the run goes.
        ground: How much the wheels slip.
        validation: How it is validated.
        console: Where progress is shown.
        init_critic: Model file of a value network that PPO's critic begins with.

    Returns:
        The best model's file.
    """
    params, weights = robot.params(), loop.check()
    settings.check()
    ground.check()
    validation.check()
    begin, begin_critic, critic = (
        None if file is None else run.own(file) for file in (loop.init, init_critic, loop.critic)
    )
    accept = {"transfer": robot.transfer}
    student = None if begin is None else read_checked(begin, params, "policy", **accept)
    value = None if begin_critic is None else read_checked(begin_critic, params, "value", **accept)
    ranker = None if critic is None else read_checked(critic, params, "value", **accept)
    suite = None if loop.tasks is None else load_tasks(loop.tasks, params)
    config = {
        **dataclasses.asdict(settings),
        **dataclasses.asdict(validation),
        "init": student and student.sha256,
        "init_critic": value and value.sha256,
        "critic": ranker and ranker.sha256,
        "reward": weights,
        "tasks": suite and [len(suite), suite.sha256],
        "segment": loop.segment,
        "validate_every": loop.validate_every,
        "device": loop.device,
        "slip": ground.slip,
        "seed": run.seed,
        "params": dataclasses.asdict(params),
    }
    from train.curves import draw_curves  # matplotlib takes a while to import

    with RunFolder(run, make.name, robot, config) as folder:
        torch.set_num_threads(1)
        warm_up(params)
        env = SnakeVecEnv(
            settings.num_envs,
            mask_in_observation=True,
            preset=robot.preset,
            task_suite=loop.tasks,
            slip=np.linspace(0.0, 2.0, settings.num_envs)[:, None] * ground.slip,
            reward_weights={**weights, "gamma": settings.gamma},
            **parse_overrides(robot.set),
        )
        learner = make(settings, env, run.seed, loop.device)
        checkpoint, total, segment = folder.path / "checkpoint.pt", settings.timesteps, 0
        if checkpoint.exists():
            segment = _restore(learner, settings, loop.segment, folder.digest, checkpoint)
        else:
            if student is not None:
                learner.begin(student.network)
            if value is not None and isinstance(learner, PPOLearner):
                learner.begin_critic(value.network)
        before = learner.model.num_timesteps
        if before >= total:
            console.print("this run is finished")
        rows: list[dict[str, Any]] = [
            row for row in folder.rows("timesteps") if int(row["timesteps"]) <= before
        ]

        def keep(**more: Any) -> Model:
            """Writes the model as it is: ``last.safetensors``."""
            made = {
                "command": command(),
                "config": config,
                "timesteps": learner.model.num_timesteps,
                **more,
            }
            kept = Model(
                "policy",
                params,
                learner.network(),
                made,
                ranker or learner.critic(params),
                "both",
                action_values=learner.action_values,
            )
            write_model(folder.path / "last.safetensors", kept)
            return kept

        def note(decisions: int, figures: dict[str, Any]) -> None:
            """Keeps the figures of an update, of a segment, or of a validation."""
            if not rows or int(rows[-1]["timesteps"]) < decisions:
                rows.append({"timesteps": decisions})
            rows[-1] |= {name: round(value, 6) for name, value in figures.items()}
            for name, value in figures.items():
                board.add_scalar(f"{make.name}/{name}", float(value), decisions)

        board = SummaryWriter(
            str(folder.path / "tensorboard"), purge_step=before + 1 if before else None
        )
        with stopping() as stop, progress(console, total, "decisions", before) as advance:
            while (before := learner.model.num_timesteps) < total and not stop.is_set():
                began = time.monotonic()
                watch = Watch(advance, make.name)
                try:
                    learner.learn(
                        before + loop.segment, segment_seed(run.seed, segment), watch, note
                    )
                except KeyboardInterrupt:
                    keep()
                    raise
                segment, now = segment + 1, learner.model.num_timesteps
                rate = round((now - before) / (time.monotonic() - began))
                note(now, {"frames_per_s": rate, **watch.figures()})
                keep()
                if segment == 1 or segment % loop.validate_every == 0 or now >= total:
                    found = validation(folder.path / "last.safetensors", params, ground.slip)
                    note(now, found)
                    validated = keep(validation=found)  # nothing that depends on the machine
                    known = [quality(row) for row in rows[:-1] if row.get("raw_success", "") != ""]
                    if not known or quality(rows[-1]) > max(known):
                        write_model(folder.path / "best.safetensors", validated)
                    console.print(_line(make.name, rows[-1]), soft_wrap=True)
                folder.write_rows(_same_columns(rows))
                board.flush()  # what is in the checkpoint is there as well
                state = {"run": folder.digest, "segment": segment, **learner.saved()}
                save_checkpoint(checkpoint, state)
        board.close()
        draw_curves([folder.path], folder.path / "curve.png")
        if learner.model.num_timesteps < total:
            raise KeyboardInterrupt
        best = folder.path / "best.safetensors"
        console.print(f"best model: {best}", soft_wrap=True)
        return best


def _restore(learner: Learner, settings: Any, length: int, run: str, path: Path) -> int:
    """Restores what a checkpoint holds; the number of segments done."""
    state = load_checkpoint(path, run, learner.model.device)
    iteration = settings.num_envs * settings.n_steps
    check_counters(path, state, settings.timesteps, length, iteration)
    try:
        learner.restore(state)
    except (RuntimeError, ValueError, TypeError, LookupError, AttributeError) as error:
        reason = str(error).split("\n", 1)[0]
        raise bad_checkpoint(path, f"the state of this learner ({reason})") from None
    return int(state["segment"])


def _line(name: str, row: dict[str, Any]) -> str:
    return (
        f"{name}: {row['timesteps']} decisions, {row['frames_per_s']}/s: "
        f"{in_words(row)} with {row['critic_rollouts']:.2f} roll-outs a decision"
    )


def _same_columns(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows with all columns that any has: validations are not in every one."""
    columns = list(dict.fromkeys(key for row in rows for key in row))
    return [{key: row.get(key, "") for key in columns} for row in rows]
