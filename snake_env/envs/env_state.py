"""What an env saves of itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from snake_env.envs.no_repeat import NoRepeat
from snake_env.errors import InvalidInputError
from snake_env.params import SnakeParams
from snake_env.sim.episode import Episodes
from snake_env.state import StateBatch


@dataclass(frozen=True, eq=False)
class EnvState:
    """What an env's ``get_state`` saves.

    Attributes:
        states: The robot, a batch of one.
        episodes: The running episode.
        no_repeat: What the no-repeat rule remembers; None: it is off.
        rng: The source of randomness.
        running: Whether the episode has not ended.
    """

    states: StateBatch
    episodes: Episodes
    no_repeat: NoRepeat | None
    rng: np.random.Generator
    running: bool

    def check(self, params: SnakeParams, *, no_repeat: bool) -> None:
        """Checks whether an env of these arguments can take it.

        Raises:
            InvalidInputError: It is from one with other constants, or another ``no_repeat``.
        """
        differing = list(self.episodes.params.differences(params))
        if (self.no_repeat is not None) != no_repeat:
            differing.append("no_repeat")
        if differing:
            expected = f"the state of an env with the same {', '.join(differing)}"
            raise InvalidInputError("state", "EnvState", expected)
