"""The option that says how slippery the floor is, for every command that plays episodes."""

from __future__ import annotations

from dataclasses import dataclass

from snake_env.envs.slip import NO_SLIP, check_slip


@dataclass(frozen=True)
class Ground:
    """The ground that the robots learn on."""

    slip: tuple[float, float] = NO_SLIP
    """How much the wheels slip: standard deviations of the head's place [m] and heading [rad] after
    each interval, for example 0.001 0.005. Each episode slips by its own share, from none to twice."""

    def check(self) -> None:
        """Raises InvalidInputError where the slip can't be used."""
        check_slip(self.slip)
