"""``python -m train ppo``."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from rich.console import Console

from agents import ppo
from harness.engine import Engine
from harness.robot import Robot
from train import rl
from train.ground import Ground
from train.run import Run
from train.validation import Validation


@dataclass(frozen=True)
class Options:
    """Train a policy by masked proximal policy optimisation (stable-baselines3)."""

    run: Run = field(default_factory=Run)
    robot: Robot = field(default_factory=Robot)
    engine: Engine = field(default_factory=Engine)
    loop: rl.Loop = field(default_factory=rl.Loop)
    ground: Ground = field(default_factory=Ground)
    validation: Validation = field(default_factory=Validation)
    settings: ppo.Settings = field(default_factory=ppo.Settings)
    init_critic: Path | None = None
    """Model file of a value network that the critic begins with, as train value makes it; {seed} stands
    for the run's seed. Default: random weights."""


def train(options: Options, console: Console) -> Path:
    """Trains; the best model's file."""
    return rl.train(
        ppo.PPOLearner,
        options.settings,
        options.run,
        options.robot,
        options.loop,
        options.ground,
        options.validation,
        console,
        init_critic=options.init_critic,
    )
