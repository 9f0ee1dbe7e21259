"""``python -m train dqn``."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from rich.console import Console

from agents import dqn
from train import rl


@dataclass(frozen=True)
class Options(rl.LearnerOptions):
    """Train a policy by masked deep Q-learning (stable-baselines3)."""

    settings: dqn.Settings = field(default_factory=dqn.Settings)


def train(options: Options, console: Console) -> Path:
    """Trains; the best model's file."""
    return rl.train(dqn.DQNLearner, options, options.settings, console)
