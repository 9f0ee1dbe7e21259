"""The training loop of PPO and DQN.

A run is a series of segments. At the beginning of each, every source of random numbers is seeded from
the run's seed and the segment's number, and the robots begin new episodes; at its end all that goes on
is saved. So a run that was killed and resumed is equal to one that was not, to the bit.
"""

from __future__ import annotations

import dataclasses
import time
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import torch
from rich.console import Console
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.utils import set_random_seed
from torch.utils.tensorboard import SummaryWriter

from agents.checks import check_device, check_positive
from agents.mlp import DivergedError
from harness.options import Assignments, parse_overrides
from harness.progress import progress
from harness.provenance import command
from harness.robot import Robot
from snake_env.envs.reward import RewardWeights
from snake_env.errors import InvalidInputError, UnknownNameError
from snake_env.networks.model_file import Model, read_network, write_model
from snake_env.policies.warm_up import warm_up
from snake_env.sb3 import SnakeVecEnv
from snake_env.sim.tasks import FROZEN, load_tasks
from train.checkpoint import bad_checkpoint, check_counters, load_checkpoint, save_checkpoint
from train.run import Run, RunFolder
from train.validation import Validation, quality
from train.watch import Watch, stopping

_LARGEST_WEIGHT = 1e6  # of a network that has not diverged


@dataclass(frozen=True)
class Loop:
    """How the run goes."""

    init: Path | None = None
    """Model file to begin with, as train imitate makes it; {seed} stands for the run's seed. Default:
    random weights."""
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
    algorithm: ModuleType,
    settings: Any,
    run: Run,
    robot: Robot,
    loop: Loop,
    validation: Validation,
    console: Console,
    *,
    init_critic: Path | None = None,
) -> Path:
    """Trains to the end, or from where an interrupted run is.

    Args:
        algorithm: A module of ``agents`` with ``build``, ``initialise``, ``iterate``, ``network``.
        settings: Its ``Settings``.
        run: Where the run is kept.
        robot: The robot's constants.
        loop: How the run goes.
        validation: How it is validated.
        console: Where progress is shown.
        init_critic: Model file of a value network that the critic begins with.

    Returns:
        The best model's file.
    """
    params, weights = robot.params(), loop.check()
    settings.check()
    validation.check()
    name = algorithm.__name__.rsplit(".", 1)[-1]
    init = None if loop.init is None else run.own(loop.init)
    accept = {"transfer": robot.transfer}
    begun = None if init is None else read_network(init, params, "policy", **accept)
    critic_from = None if init_critic is None else run.own(init_critic)
    critic = None if critic_from is None else read_network(critic_from, params, "value", **accept)
    suite = None if loop.tasks is None else load_tasks(loop.tasks, params)
    config = {
        **dataclasses.asdict(settings),
        **dataclasses.asdict(validation),
        "init": None if init is None else str(init),
        "init_critic": None if critic_from is None else str(critic_from),
        "reward": weights,
        "tasks": suite and [suite.name, len(suite), suite.sha256],
        "segment": loop.segment,
        "validate_every": loop.validate_every,
        "device": loop.device,
        "seed": run.seed,
        "params": dataclasses.asdict(params),
    }
    from train.curves import draw_curves  # matplotlib takes a while to import

    with RunFolder(run, name, robot, config) as folder:
        torch.set_num_threads(1)
        warm_up(params)
        env = SnakeVecEnv(
            settings.num_envs,
            mask_in_observation=True,
            preset=robot.preset,
            task_suite=loop.tasks,
            reward_weights={**weights, "gamma": settings.gamma},
            **parse_overrides(robot.set),
        )
        model = algorithm.build(settings, env, run.seed, loop.device)
        model.set_logger(Logger(folder=None, output_formats=[]))
        checkpoint = folder.path / "checkpoint.pt"
        segment = 0
        if checkpoint.exists():
            args = (settings, loop.segment, folder.digest, checkpoint)
            segment = _load(algorithm, model, *args)
        else:
            if begun is not None:
                algorithm.initialise(model, begun, settings)
            if critic is not None:
                algorithm.initialise_critic(model, critic, weights)
        total, before = settings.timesteps, model.num_timesteps
        if before >= total:
            console.print("this run is finished")
        rows: list[dict[str, Any]] = [
            row for row in folder.rows("timesteps") if int(row["timesteps"]) <= before
        ]

        def keep(**more: Any) -> Model:
            """Writes the model as it is: ``last.safetensors``."""
            made = {"command": command(), "config": config, "timesteps": model.num_timesteps}
            kept = Model("policy", params, algorithm.network(model), {**made, **more})
            write_model(folder.path / "last.safetensors", kept)
            return kept

        board = SummaryWriter(
            str(folder.path / "tensorboard"), purge_step=before + 1 if before else None
        )
        with stopping() as stop, progress(console, total, "decisions", before) as advance:
            while model.num_timesteps < total and not stop.is_set():
                began, before = time.monotonic(), model.num_timesteps
                watch = Watch(advance, name)
                try:
                    _segment(algorithm, model, settings, run.seed, segment, loop.segment, watch)
                except KeyboardInterrupt:
                    keep()
                    raise
                segment += 1
                rate = (model.num_timesteps - before) / (time.monotonic() - began)
                row = {"timesteps": model.num_timesteps, "frames_per_s": round(rate)}
                row |= watch.figures()
                keep()
                if segment % loop.validate_every == 0 or model.num_timesteps >= total:
                    row |= validation(folder.path / "last.safetensors", params)
                    validated = keep(validation=row)
                    known = [quality(r) for r in rows if r.get("raw_success", "") != ""]
                    if not known or quality(row) > max(known):
                        write_model(folder.path / "best.safetensors", validated)
                    console.print(_line(name, row), soft_wrap=True)
                rows.append(row)
                folder.write_rows(_same_columns(rows))
                for key, value in row.items():
                    board.add_scalar(f"{name}/{key}", float(value), model.num_timesteps)
                board.flush()  # what is in the checkpoint is there as well
                _save(algorithm, model, segment, folder.digest, checkpoint)
        board.close()
        draw_curves([folder.path], folder.path / "curve.png")
        if model.num_timesteps < total:
            raise KeyboardInterrupt
        best = folder.path / "best.safetensors"
        console.print(f"best model: {best}", soft_wrap=True)
        return best


def _segment(
    algorithm: ModuleType,
    model: Any,
    settings: Any,
    seed: int,
    segment: int,
    length: int,
    watch: Watch,
) -> None:
    """Learns from ``length`` decisions, or some more: whole iterations."""
    fresh = int(np.random.SeedSequence([seed, segment]).generate_state(1)[0]) // 2
    set_random_seed(fresh)
    model.action_space.seed(fresh)
    model.env.seed(fresh)
    model._last_obs = None  # SB3 then begins new episodes
    _, callback = model._setup_learn(settings.timesteps, watch, reset_num_timesteps=False)
    model._total_timesteps = settings.timesteps
    end = min(model.num_timesteps + length, settings.timesteps)
    while model.num_timesteps < end:
        model._update_current_progress_remaining(model.num_timesteps, settings.timesteps)
        try:
            algorithm.iterate(model, callback, settings)
        except ValueError:  # what is no number is no distribution and no choice
            if all(
                bool((part.abs() < _LARGEST_WEIGHT).all()) for part in model.policy.parameters()
            ):
                raise
            raise DivergedError(settings.learning_rate) from None


def _save(algorithm: ModuleType, model: Any, segment: int, run: str, path: Path) -> None:
    """Saves all that continues after a segment."""
    state = {
        "run": run,
        "segment": segment,
        "num_timesteps": model.num_timesteps,
        "n_updates": model._n_updates,
        "policy": model.policy.state_dict(),
        "optimizer": model.policy.optimizer.state_dict(),
        "extra": algorithm.extra_state(model),
    }
    save_checkpoint(path, state)


def _load(
    algorithm: ModuleType, model: Any, settings: Any, length: int, run: str, path: Path
) -> int:
    """Restores what was saved; the number of segments done."""
    state = load_checkpoint(path, run, model.device)
    iteration = settings.num_envs * settings.n_steps
    check_counters(path, state, settings.timesteps, length, iteration)
    try:
        model.policy.load_state_dict(state["policy"])
        model.policy.optimizer.load_state_dict(state["optimizer"])
        algorithm.set_extra_state(model, state["extra"])
    except (RuntimeError, ValueError, TypeError, LookupError, AttributeError) as error:
        reason = str(error).split("\n", 1)[0]
        raise bad_checkpoint(path, f"the state of this learner ({reason})") from None
    model.num_timesteps, model._n_updates = state["num_timesteps"], state["n_updates"]
    return int(state["segment"])


def _line(name: str, row: dict[str, Any]) -> str:
    return (
        f"{name}: {row['timesteps']} decisions, {row['frames_per_s']}/s: "
        f"raw {row['raw_success']:.1%} in {row['raw_time_s']:.1f} s, "
        f"shielded {row['shielded_success']:.1%} in {row['shielded_time_s']:.1f} s "
        f"with {row['shielded_rollouts']:.2f} roll-outs a decision"
    )


def _same_columns(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows with all columns that any has: validations are not in every one."""
    columns = list(dict.fromkeys(key for row in rows for key in row))
    return [{key: row.get(key, "") for key in columns} for row in rows]
