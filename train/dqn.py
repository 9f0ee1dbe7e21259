"""``python -m train dqn``."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from rich.console import Console

from agents import dqn
from harness.engine import Engine
from harness.robot import Robot
from train import rl
from train.ground import Ground
from train.run import Run
from train.validation import Validation


@dataclass(frozen=True)
class Options:
    """Train a policy by masked deep Q-learning (stable-baselines3)."""

    run: Run = field(default_factory=Run)
    robot: Robot = field(default_factory=Robot)
    engine: Engine = field(default_factory=Engine)
    loop: rl.Loop = field(default_factory=rl.Loop)
    ground: Ground = field(default_factory=Ground)
    validation: Validation = field(default_factory=Validation)
    settings: dqn.Settings = field(default_factory=dqn.Settings)


def train(options: Options, console: Console) -> Path:
    """Trains; the best model's file."""
    return rl.train(
        dqn.DQNLearner,
        options.settings,
        options.run,
        options.robot,
        options.loop,
        options.ground,
        options.validation,
        console,
    )
