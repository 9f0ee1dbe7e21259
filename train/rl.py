"""The training loop of PPO and DQN.

A run is a series of segments. At the beginning of each, every source of random numbers is seeded from
the run's seed and the segment's number, and the robots begin new episodes; at its end all that goes on
is saved. So a run that was killed and resumed is equal to one that was not, to the bit.
"""

from __future__ import annotations

import dataclasses
import io
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import joblib
import numpy as np
import torch
from rich.console import Console
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.utils import set_random_seed
from torch.utils.tensorboard import SummaryWriter

from agents.checks import check_device, check_positive
from evaluate.journal import write_atomically
from evaluate.options import Assignments, parse_overrides
from evaluate.progress import Advance, progress
from snake_env.envs.reward import RewardWeights
from snake_env.errors import InvalidInputError, UnknownNameError
from snake_env.networks.model_file import Model, read_network, write_model
from snake_env.policies.warm_up import warm_up
from snake_env.sb3 import SnakeVecEnv
from snake_env.sim.tasks import FROZEN, load_tasks
from train.curves import draw_curves
from train.run import Robot, Run, RunFolder, command
from train.validation import Validation, quality


@dataclass(frozen=True)
class Loop:
    """How the run goes."""

    init: Path | None = None
    """Model file to begin with, as train imitate makes it; {seed} stands for the run's seed. Default:
    random weights."""
    reward: Assignments = ()
    """Replaces a weight of the reward, for example --reward time=-0.05; may be repeated."""
    tasks: str | None = None
    """Suite of tasks to learn from, as in python -m evaluate --tasks; default: ever new random ones."""
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
        "tasks": suite and [suite.name, len(suite), joblib.hash((suite.phi0, suite.target))],
        "segment": loop.segment,
        "validate_every": loop.validate_every,
        "device": loop.device,
        "seed": run.seed,
        "params": dataclasses.asdict(params),
    }
    folder = RunFolder(run, name, robot, config)
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
    if run.resume and checkpoint.exists():
        segment = _load(algorithm, model, checkpoint)
    else:
        if begun is not None:
            algorithm.initialise(model, begun, settings)
        if critic is not None:
            algorithm.initialise_critic(model, critic, weights)
    total = settings.timesteps
    rows: list[dict[str, Any]] = [
        row for row in folder.rows() if int(row["timesteps"]) <= model.num_timesteps
    ]
    board = SummaryWriter(str(folder.path / "tensorboard"), purge_step=model.num_timesteps)
    with _stopping() as stop, progress(console, total, "decisions") as advance:
        advance(name, model.num_timesteps)
        while model.num_timesteps < total and not stop.is_set():
            began, before = time.monotonic(), model.num_timesteps
            watch = _Watch(advance, name)
            _segment(algorithm, model, settings, run.seed, segment, loop.segment, watch)
            segment += 1
            rate = (model.num_timesteps - before) / (time.monotonic() - began)
            row = {"timesteps": model.num_timesteps, "frames_per_s": round(rate), **watch.figures()}
            done = model.num_timesteps >= total
            if segment % loop.validate_every == 0 or done:
                made = {"command": command(), "config": config, "timesteps": model.num_timesteps}
                last, network = folder.path / "last.safetensors", algorithm.network(model)
                write_model(last, Model("policy", params, network, made))
                row |= validation(last, params)
                validated = Model("policy", params, network, {**made, "validation": row})
                write_model(last, validated)
                known = [quality(r) for r in rows if r.get("raw_success", "") != ""]
                if not known or quality(row) > max(known):
                    write_model(folder.path / "best.safetensors", validated)
                console.print(_line(name, row), soft_wrap=True)
            rows.append(row)
            folder.write_rows(_same_columns(rows))
            for key, value in row.items():
                board.add_scalar(f"{name}/{key}", float(value), model.num_timesteps)
            _save(algorithm, model, segment, checkpoint)
    board.close()
    draw_curves([folder.path], folder.path / "curve.png")
    if model.num_timesteps < total:
        raise KeyboardInterrupt
    console.print(f"best model: {folder.path / 'best.safetensors'}", soft_wrap=True)
    return folder.path / "best.safetensors"


def _segment(
    algorithm: ModuleType,
    model: Any,
    settings: Any,
    seed: int,
    segment: int,
    length: int,
    watch: _Watch,
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
        algorithm.iterate(model, callback, settings)


class _Watch(BaseCallback):
    """Shows progress and keeps the figures of the segment's episodes."""

    def __init__(self, advance: Advance, name: str) -> None:
        super().__init__()
        self._advance, self._name = advance, name
        self._episodes: list[dict[str, Any]] = []

    def _on_step(self) -> bool:
        infos = self.locals["infos"]
        self._episodes += [info for info in infos if "episode_summary" in info]
        self._advance(self._name, len(infos))
        return True

    def figures(self) -> dict[str, float]:
        """Return, success rate and mean time of the episodes that ended, exploration included."""
        solved = [e["episode_summary"]["time_s"] for e in self._episodes if e["is_success"]]
        count = max(1, len(self._episodes))
        return {
            "train_return": round(sum(e["episode"]["r"] for e in self._episodes) / count, 4),
            "train_success": round(len(solved) / count, 4),
            "train_time_s": round(float(np.mean(solved)) if solved else float("nan"), 3),
        }


def _save(algorithm: ModuleType, model: Any, segment: int, path: Path) -> None:
    """Saves all that goes on after a segment, atomically."""
    state = {
        "segment": segment,
        "num_timesteps": model.num_timesteps,
        "n_updates": model._n_updates,
        "policy": model.policy.state_dict(),
        "optimizer": model.policy.optimizer.state_dict(),
        "extra": algorithm.extra_state(model),
    }
    file = io.BytesIO()
    torch.save(state, file)
    write_atomically(path, file.getvalue())


def _load(algorithm: ModuleType, model: Any, path: Path) -> int:
    """Restores what was saved; the number of segments done."""
    try:
        state = torch.load(path, weights_only=True, map_location=model.device)
    except Exception as error:  # torch raises many kinds on a damaged file
        reason = str(error).split("\n", 1)[0]
        raise InvalidInputError("checkpoint", str(path), f"an undamaged file ({reason})") from None
    model.policy.load_state_dict(state["policy"])
    model.policy.optimizer.load_state_dict(state["optimizer"])
    model.num_timesteps, model._n_updates = state["num_timesteps"], state["n_updates"]
    algorithm.set_extra_state(model, state["extra"])
    return int(state["segment"])


@contextmanager
def _stopping() -> Iterator[threading.Event]:
    """An event that Ctrl-C and SIGTERM set; the segment is finished then. A second one interrupts."""
    stop = threading.Event()

    def handle(number: int, frame: Any) -> None:
        if stop.is_set():
            raise KeyboardInterrupt
        stop.set()
        print("\nstopping after this segment (again: at once)", flush=True)

    if threading.current_thread() is not threading.main_thread():
        yield stop
        return
    before = {number: signal.signal(number, handle) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


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
