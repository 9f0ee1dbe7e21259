"""The spaces of one robot's actions and observations."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from snake_env.envs.core import EnvOptions
from snake_env.modes import mode_table
from snake_env.sim.observation import observation_size


def action_space(options: EnvOptions) -> spaces.Discrete:
    """The action space of one env."""
    return spaces.Discrete(len(mode_table(options.params.n_joints)))


def observation_space(options: EnvOptions) -> spaces.Space[NDArray[np.float32]]:
    """The observation space of one env."""
    shape = (observation_size(options.params.n_joints),)
    space: Any = spaces.Box(-1.0, 1.0, shape, np.float32)
    return cast(spaces.Space[NDArray[np.float32]], space)
