"""The training loop of PPO and DQN.

A run is a series of segments. At the beginning of each, every source of random numbers is seeded from
the run's seed and the segment's number, and the robots begin new episodes. At its end the whole state
is saved. So a run that was killed and resumed equals one that was not, bit for bit.
"""

from __future__ import annotations

import dataclasses
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from rich.console import Console

from agents.checks import check_device, check_positive
from agents.dqn import DQNLearner
from agents.learner import Learner
from agents.ppo import PPOLearner
from harness.engine import Engine
from harness.options import Assignments
from harness.progress import progress
from harness.provenance import command
from harness.robot import Robot
from snake_env.envs.core import checked_weights
from snake_env.errors import InvalidInputError
from snake_env.networks.model_file import Kind, Model, write_model
from snake_env.params import SnakeParams, parse_overrides
from snake_env.sb3 import SnakeVecEnv
from snake_env.sim.tasks import FROZEN, load_tasks
from snake_env.sim.warm_up import warm_up
from train.checkpoint import bad_checkpoint, check_counters, load_checkpoint, save_checkpoint
from train.ground import Ground
from train.initial_models import read_checked
from train.log import RunLog
from train.run import Run, RunFolder, part_seed
from train.validation import Validation, in_words
from train.watch import Watch, stopping


@dataclass(frozen=True)
class Loop:
    """Training loop."""

    init: Path | None = None
    """Initial model, for example of train imitate; {seed} is replaced by the run's seed. Default:
    random weights."""
    critic: Path | None = None
    """Model file of the value network that +critic uses; it is stored in the model. Default: PPO's own
    critic, or DQN's action values."""
    reward: Assignments = ()
    """Replaces a weight of the reward, for example --reward time=-0.05. May be repeated."""
    tasks: str | None = None
    """Suite of tasks to learn from, as in python -m evaluate --tasks. Default: random tasks."""
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
            raise InvalidInputError(
                "tasks", self.tasks, "a suite that is not reserved for evaluation"
            )
        return dataclasses.asdict(checked_weights(parse_overrides(self.reward)))


@dataclass(frozen=True)
class LearnerOptions:
    """What PPO and DQN have in common; each adds its settings."""

    run: Run = field(default_factory=Run)
    robot: Robot = field(default_factory=Robot)
    engine: Engine = field(default_factory=Engine)
    """Parallel execution of several --seeds; a single run uses one process."""
    loop: Loop = field(default_factory=Loop)
    ground: Ground = field(default_factory=Ground)
    validation: Validation = field(default_factory=Validation)


@dataclass(frozen=True)
class Given:
    """Models that a run begins with; None: it begins without."""

    init: Model | None
    init_critic: Model | None
    critic: Model | None


def train(
    make: type[PPOLearner] | type[DQNLearner],
    options: LearnerOptions,
    settings: Any,
    console: Console,
    *,
    init_critic: Path | None = None,
) -> Path:
    """Trains to the end, or from where an interrupted run is.

    Args:
        make: The learner.
        options: The command's options.
        settings: The learner's ``Settings``.
        console: Where progress is shown.
        init_critic: Model file of a value network that PPO's critic begins with.

    Returns:
        The best model's file.
    """
    run, loop, params = options.run, options.loop, options.robot.params()
    weights = loop.check()
    for part in (options.engine, options.ground, options.validation, settings):
        part.check()
    given = _read(options, init_critic, params)
    config = _config(options, settings, given, weights, params)
    from train.curves import draw_curves  # matplotlib takes a while to import

    with RunFolder(run, make.name, options.robot, config) as folder:
        torch.set_num_threads(1)
        warm_up(params)
        learner = make(settings, _env(options, settings, weights), run.seed, loop.device)
        total, segment = settings.timesteps, _begin(learner, settings, loop, given, folder)
        before = learner.model.num_timesteps
        if before >= total:
            console.print("this run is finished")
        log = RunLog(folder, make.name, before)

        def keep(**more: Any) -> Model:
            """Writes the model as it is: ``last.safetensors``."""
            done = learner.model.num_timesteps
            made = {"command": command(), "config": config, "timesteps": done, **more}
            critic = given.critic or learner.critic(params)
            kept = Model(
                "policy",
                params,
                learner.network(),
                made,
                critic,
                "both",
                action_values=learner.action_values,
            )
            write_model(folder.path / "last.safetensors", kept)
            return kept

        with stopping() as stop, progress(console, total, "decisions", before) as advance:
            while (before := learner.model.num_timesteps) < total and not stop.is_set():
                began = time.monotonic()
                watch, seed = Watch(advance, make.name), part_seed(run.seed, segment)
                try:
                    learner.learn(before + loop.segment, seed, watch, log.note)
                except KeyboardInterrupt:
                    keep()
                    raise
                segment, now = segment + 1, learner.model.num_timesteps
                rate = round((now - before) / (time.monotonic() - began))
                log.note(now, {"frames_per_s": rate, **watch.figures()})
                keep()
                if segment == 1 or segment % loop.validate_every == 0 or now >= total:
                    last = folder.path / "last.safetensors"
                    found = options.validation(last, params, options.ground.slip)
                    log.note(now, found)
                    validated = keep(validation=found)  # nothing that depends on the machine
                    if log.is_best():
                        write_model(folder.path / "best.safetensors", validated)
                    console.print(_line(make.name, log.rows[-1]), soft_wrap=True)
                log.write()
                state = {"run": folder.digest, "segment": segment, **learner.saved()}
                save_checkpoint(folder.path / "checkpoint.pt", state)
        log.close()
        draw_curves([folder.path], folder.path / "curve.png")
        if learner.model.num_timesteps < total:
            raise KeyboardInterrupt
        best = folder.path / "best.safetensors"
        console.print(f"best model: {best}", soft_wrap=True)
        return best


def _read(options: LearnerOptions, init_critic: Path | None, params: SnakeParams) -> Given:
    """The models that the options name."""

    def read(file: Path | None, kind: Kind) -> Model | None:
        if file is None:
            return None
        own = options.run.own(file)
        return read_checked(own, params, kind, transfer=options.robot.transfer)

    loop = options.loop
    return Given(read(loop.init, "policy"), read(init_critic, "value"), read(loop.critic, "value"))


def _config(
    options: LearnerOptions,
    settings: Any,
    given: Given,
    weights: dict[str, float],
    params: SnakeParams,
) -> dict[str, Any]:
    """Everything that a run depends on: it is resumed with the same, and its models record it."""
    loop = options.loop
    suite = None if loop.tasks is None else load_tasks(loop.tasks, params)
    return {
        **dataclasses.asdict(settings),
        **dataclasses.asdict(options.validation),
        "init": given.init and given.init.sha256,
        "init_critic": given.init_critic and given.init_critic.sha256,
        "critic": given.critic and given.critic.sha256,
        "reward": weights,
        "tasks": suite and [len(suite), suite.sha256],
        "segment": loop.segment,
        "validate_every": loop.validate_every,
        "device": loop.device,
        "slip": options.ground.slip,
        "seed": options.run.seed,
        "params": dataclasses.asdict(params),
    }


def _env(options: LearnerOptions, settings: Any, weights: dict[str, float]) -> SnakeVecEnv:
    """The environments that the learner acts in, each with its share of the slip."""
    count = settings.num_envs
    shares = np.linspace(0.0, 2.0, count)[:, None] if count > 1 else np.ones((1, 1))
    return SnakeVecEnv(
        settings.num_envs,
        mask_in_observation=True,
        preset=options.robot.preset,
        task_suite=options.loop.tasks,
        slip=shares * options.ground.slip,
        reward_weights={**weights, "gamma": settings.gamma},
        **parse_overrides(options.robot.set),
    )


def _begin(learner: Learner, settings: Any, loop: Loop, given: Given, folder: RunFolder) -> int:
    """Restores the checkpoint, or begins with the models that are given; the segments done."""
    checkpoint = folder.path / "checkpoint.pt"
    if checkpoint.exists():
        return _restore(learner, settings, loop.segment, folder.digest, checkpoint)
    if given.init is not None:
        learner.begin(given.init.network)
    if given.init_critic is not None and isinstance(learner, PPOLearner):
        learner.begin_critic(given.init_critic.network)
    return 0


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
