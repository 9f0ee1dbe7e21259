"""Options that choose the robot: a preset of constants, and changes to it."""

from __future__ import annotations

from dataclasses import dataclass

from harness.files import file_name
from harness.options import Assignments
from snake_env.params import SnakeParams, parse_overrides


@dataclass(frozen=True)
class Robot:
    """The robot's constants."""

    preset: str = "paper"
    """Constants of the robot: paper, hardware, narrow, six or ten."""
    set: Assignments = ()
    """Replaces a constant of the preset, for example --set a_c=67; may be repeated."""
    transfer: bool = False
    """Accept models that were trained with other constants."""

    def params(self) -> SnakeParams:
        """The constants.

        Raises:
            SnakeEnvError: A name does not exist or a value can't be used.
        """
        return SnakeParams.preset(self.preset, **parse_overrides(self.set))

    @property
    def name(self) -> str:
        """The preset and what is changed in it, as part of a folder's name."""
        return file_name("-".join([self.preset, *self.set]))
