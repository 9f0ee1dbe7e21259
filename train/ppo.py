"""``python -m train ppo``."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from rich.console import Console

from agents import ppo
from train import rl


@dataclass(frozen=True)
class Options(rl.LearnerOptions):
    """Train a policy by masked proximal policy optimisation (stable-baselines3)."""

    settings: ppo.Settings = field(default_factory=ppo.Settings)
    init_critic: Path | None = None
    """Initial critic: a model file of train value; {seed} is replaced by the run's seed. Default:
    random weights."""


def train(options: Options, console: Console) -> Path:
    """Trains; the best model's file."""
    return rl.train(
        ppo.PPOLearner, options, options.settings, console, init_critic=options.init_critic
    )
