"""The option that says how slippery the floor is, for every command that plays episodes."""

from __future__ import annotations

from dataclasses import dataclass

from snake_env.sim.slip import NO_SLIP, check_slip


@dataclass(frozen=True)
class Ground:
    """The ground that the robots learn on."""

    slip: tuple[float, float] = NO_SLIP
    """Wheel slip: standard deviations of the head's position [m] and heading [rad] per interval, for
    example 0.001 0.005. Training scales it by a factor from 0 to 2: per episode, for ppo and dqn per
    environment."""

    def check(self) -> None:
        """Raises InvalidInputError where the slip can't be used."""
        check_slip(self.slip)
