"""The modes: which wheels behind the SCP are lifted (section III-A)."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from snake_env.errors import InvalidInputError, InvalidModeError, as_integer
from snake_env.params import N_JOINTS_RANGE

MIN_GROUNDED = 3  # axles that must stay on the ground


class ModeTable:
    """All modes of a robot with ``n_joints`` yaw joints, and which of them each phase allows.

    A mode is a set of lifted rear wheels. Its index means the same wheels in every phase; the SCP's
    own wheel is always lifted besides. The order is by number of lifted wheels, then lexicographic by
    wheel number: 0 lifts none, 1..n-1 lift wheel 2..n alone, and so on.

    Attributes:
        n_joints: Number of yaw joints and wheels, n.
        lifted: Rear wheels lifted by each mode, shape (n_modes, n); column k - 1 is wheel k.
        n_lifted: How many rear wheels each mode lifts, shape (n_modes,).
        wheels: Their numbers in rising order, then zeros, shape (n_modes, n - 4).

    Raises:
        InvalidInputError: ``n_joints`` is out of range.
    """

    def __init__(self, n_joints: int) -> None:
        low, high = N_JOINTS_RANGE
        given = as_integer(n_joints)
        if given is None or not low <= given <= high:
            raise InvalidInputError("n_joints", n_joints, f"an integer from {low} to {high}")
        self.n_joints = n_joints = given
        most = n_joints - 1 - MIN_GROUNDED
        patterns = [
            wheels
            for count in range(most + 1)
            for wheels in itertools.combinations(range(2, n_joints + 1), count)
        ]
        self._index = {wheels: index for index, wheels in enumerate(patterns)}
        self.n_lifted = np.array([len(wheels) for wheels in patterns], dtype=np.int64)
        self.wheels = np.zeros((len(patterns), most), dtype=np.int64)
        self.lifted = np.zeros((len(patterns), n_joints), dtype=np.bool_)
        for index, wheels in enumerate(patterns):
            self.wheels[index, : len(wheels)] = wheels
            self.lifted[index, [wheel - 1 for wheel in wheels]] = True
        foremost = np.where(self.n_lifted > 0, self.wheels[:, 0], n_joints + 1)
        phases = np.arange(1, n_joints + 2)
        allowed = (foremost > phases[:, None]) & (phases[:, None] <= n_joints)
        # Wheels 1..phase-1 are grounded, so a mode that is valid here leaves 3 of the n grounded.
        self._masks = allowed
        # In the last row, when the target is reached, there is no SCP.
        self._scp = np.eye(n_joints + 1, n_joints, dtype=np.bool_)
        for array in (self.n_lifted, self.wheels, self.lifted, self._masks, self._scp):
            array.setflags(write=False)

    def __len__(self) -> int:
        return len(self.lifted)

    def mask(self, phase: int) -> NDArray[np.bool_]:
        """Which modes a phase allows, shape (n_modes,); none once the target is reached.

        Args:
            phase: 1..n + 1.

        Raises:
            InvalidInputError: The phase is out of range.
        """
        given = as_integer(phase)
        if given is None or not 1 <= given <= self.n_joints + 1:
            raise InvalidInputError("phase", phase, f"an integer from 1 to {self.n_joints + 1}")
        mask: NDArray[np.bool_] = self._masks[phase - 1]
        return mask

    def masks(self, phases: NDArray[np.int64]) -> NDArray[np.bool_]:
        """:meth:`mask` of many phases, shape (N, n_modes)."""
        mask: NDArray[np.bool_] = self._masks[phases - 1]
        return mask

    def lifted_wheels(
        self, modes: NDArray[np.int64], phases: NDArray[np.int64] | np.int64
    ) -> NDArray[np.bool_]:
        """All wheels in the air, the SCP's included, for modes and their phases: shape (..., n)."""
        lifted: NDArray[np.bool_] = self.lifted[modes] | self._scp[phases - 1]
        return lifted

    def valid_pairs(
        self, modes: NDArray[np.int64], phases: NDArray[np.int64] | np.int64
    ) -> NDArray[np.bool_]:
        """Whether each of N modes exists and is allowed in its phase, shape (N,)."""
        inside = (modes >= 0) & (modes < len(self))
        valid: NDArray[np.bool_] = self._masks[phases - 1, np.where(inside, modes, 0)] & inside
        return valid

    def valid(self, phase: int) -> NDArray[np.int64]:
        """Indices of the modes that a phase allows, in rising order, shape (M,).

        Raises:
            InvalidInputError: The phase is out of range.
        """
        return np.flatnonzero(self.mask(phase))

    def index(self, wheels: Iterable[int]) -> int:
        """Index of the mode that lifts just these rear wheels.

        Args:
            wheels: Wheel numbers, 2..n, in any order.

        Raises:
            InvalidModeError: No mode lifts these wheels.
        """
        given = list(wheels) if isinstance(wheels, Iterable) else [wheels]
        numbers = [number for wheel in given if (number := as_integer(wheel)) is not None]
        key = tuple(sorted(numbers))
        if key not in self._index or len(key) < len(given):
            most = self.n_joints - 1 - MIN_GROUNDED
            expected = f"at most {most} different wheels from 2 to {self.n_joints}"
            raise InvalidModeError("wheels", given, expected)
        return self._index[key]

    def check(self, mode: int, phase: int) -> int:
        """The mode's index as a plain integer, if the phase allows it.

        Raises:
            InvalidModeError: The index is out of range, or lifts the SCP's wheel or one before it.
        """
        index = as_integer(mode)
        if index is None or not 0 <= index < len(self):
            raise InvalidModeError("mode", mode, f"an integer from 0 to {len(self) - 1}")
        if not self.mask(phase)[index]:
            wheels = ", ".join(str(wheel) for wheel in self.wheels[index] if wheel)
            raise InvalidModeError(
                "mode",
                index,
                f"a mode valid in phase {phase} (rear wheels {phase + 1}..{self.n_joints} are free; "
                f"this one lifts {wheels})"
                if phase <= self.n_joints
                else "no mode: the target is reached",
            )
        return index


@functools.cache
def mode_table(n_joints: int) -> ModeTable:
    """The shared, immutable table for ``n_joints``."""
    return ModeTable(n_joints)
