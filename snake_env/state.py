"""State of the robot between two intervals: :class:`SnakeState`, and many at once: `StateBatch`."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from snake_env.errors import InvalidInputError, as_integer
from snake_env.kernel.distance import d_min
from snake_env.params import SnakeParams

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class SnakeState:
    """The robot at a switching time t_k.

    The arrays are this state's own copies and read-only: make a new state with :meth:`replace`.

    Attributes:
        w: Head pose (x_0, y_0, theta_0), shape (3,) [m, m, rad].
        phi: Joint angles, shape (n,) [rad].
        target: Target joint angles, shape (n,) [rad].
        phase: 1..n: the number of the joint that is the SCP; n + 1: the target is reached.
        phase_time: Time since the phase began [s].
        ref_start: The SCP's angle when the phase began, where its cam curve starts [rad].
        elapsed: Time since the episode began [s].
        last_mode: The mode of the last interval; -1 at the beginning. The robot does not depend on it,
            but who chooses the next mode may want to know.
        last_turn: How far the SCP of the last interval turned in it [rad].

    Raises:
        InvalidInputError: An array holds anything other than numbers.
    """

    w: FloatArray
    phi: FloatArray
    target: FloatArray
    phase: int
    phase_time: float
    ref_start: float
    elapsed: float
    last_mode: int = -1
    last_turn: float = 0.0

    def __post_init__(self) -> None:
        for name in ("w", "phi", "target"):
            given = getattr(self, name)
            if not (isinstance(given, np.ndarray) and _is_frozen(given)):
                object.__setattr__(self, name, _frozen_copy(f"state.{name}", given))

    def __reduce__(self) -> tuple[Any, ...]:
        return remade(self)

    @classmethod
    def initial(cls, phi0: ArrayLike, target: ArrayLike, params: SnakeParams) -> SnakeState:
        """State in which an episode begins: phase 1, head at ``params.w_d``.

        Args:
            phi0: Initial joint angles, shape (n,) [rad].
            target: Target joint angles, shape (n,) [rad].
            params: The constants.

        Raises:
            InvalidInputError: A shape has a wrong length, is not finite, passes the joint limits or
                collides with itself (d_min < 2 l).
        """
        phi = checked_shape("phi0", phi0, params)
        wanted = checked_shape("target", target, params)
        return cls(
            w=np.array(params.w_d),
            phi=phi,
            target=wanted,
            phase=1,
            phase_time=0.0,
            ref_start=float(phi[0]),
            elapsed=0.0,
        )

    @property
    def done(self) -> bool:
        """Whether every joint has reached its target in its phase."""
        return self.phase > len(self.phi)

    def replace(self, **changes: Any) -> SnakeState:
        """A copy with some fields replaced."""
        return dataclasses.replace(self, **changes)


@dataclass(frozen=True, eq=False)
class StateBatch:
    """Many states, field by field: the attributes are those of :class:`SnakeState`, in arrays.

    The arrays are read-only: they are views of those that are given, which are not copied.

    Attributes:
        w: Head poses, shape (N, 3) [m, m, rad].
        phi: Joint angles, shape (N, n) [rad].
        target: Target joint angles, shape (N, n) [rad].
        phase: Phases, shape (N,).
        phase_time: Times since the phase began, shape (N,) [s].
        ref_start: Where the cam curves start, shape (N,) [rad].
        elapsed: Times since the episodes began, shape (N,) [s].
        last_mode: Modes of the last interval, shape (N,).
        last_turn: How far the SCPs turned in it, shape (N,) [rad].
    """

    w: FloatArray
    phi: FloatArray
    target: FloatArray
    phase: IntArray
    phase_time: FloatArray
    ref_start: FloatArray
    elapsed: FloatArray
    last_mode: IntArray
    last_turn: FloatArray

    def __post_init__(self) -> None:
        fields = self.__dict__  # of a frozen class: what object.__setattr__ does, only sooner
        for name in _FIELDS:
            fields[name] = read_only(fields[name])

    def __reduce__(self) -> tuple[Any, ...]:
        return remade(self)

    def __len__(self) -> int:
        return len(self.phase)

    def __getitem__(self, k: int) -> SnakeState:
        fields: dict[str, Any] = {}
        for name in _FIELDS:
            value = getattr(self, name)[k]
            fields[name] = _frozen(value) if isinstance(value, np.ndarray) else value.item()
        return SnakeState(**fields)

    @classmethod
    def stack(cls, states: Sequence[SnakeState]) -> StateBatch:
        """A batch of the given states, copied.

        Raises:
            InvalidInputError: A phase or a mode is not an integer.
        """
        for name, dtype in _FIELDS.items():
            for state in states if dtype is np.int64 else ():
                if as_integer(getattr(state, name)) is None:
                    raise InvalidInputError(f"state.{name}", getattr(state, name), "an integer")
        return cls(
            **{
                name: np.array([getattr(state, name) for state in states], dtype=dtype)
                for name, dtype in _FIELDS.items()
            }
        )

    @classmethod
    def initial(cls, phi0: FloatArray, target: FloatArray, params: SnakeParams) -> StateBatch:
        """States in which episodes begin, for shapes (N, n) [rad] that are known to be usable."""
        count = len(phi0)
        return cls(
            w=np.tile(np.array(params.w_d), (count, 1)),
            phi=phi0.copy(),
            target=target.copy(),
            phase=np.ones(count, dtype=np.int64),
            phase_time=np.zeros(count),
            ref_start=phi0[:, 0].copy(),
            elapsed=np.zeros(count),
            last_mode=np.full(count, -1, dtype=np.int64),
            last_turn=np.zeros(count),
        )

    def take(self, indices: ArrayLike) -> StateBatch:
        """The states at the given positions, in their order; an index may come many times."""
        chosen = np.asarray(indices, dtype=np.intp)
        # numpy.take copies rows several times as fast as indexing does
        return StateBatch(**{name: getattr(self, name).take(chosen, axis=0) for name in _FIELDS})

    def put(self, indices: ArrayLike, other: StateBatch) -> StateBatch:
        """A copy in which the states at the given positions are the other's."""
        chosen = np.asarray(indices, dtype=np.intp)
        fields = {name: getattr(self, name).copy() for name in _FIELDS}
        for name, values in fields.items():
            values[chosen] = getattr(other, name)
        return StateBatch(**fields)


_FIELDS: dict[str, type] = {
    field.name: np.int64 if field.name in ("phase", "last_mode") else np.float64
    for field in dataclasses.fields(SnakeState)
}


def read_only(array: NDArray[Any]) -> NDArray[Any]:
    """A view of an array through which nothing can be written."""
    view = array.view()
    view.setflags(write=False)
    return view


def remade(instance: Any) -> tuple[Any, ...]:
    """What ``__reduce__`` gives for a dataclass: pickled arrays forget that they are read-only."""
    values = [getattr(instance, field.name) for field in dataclasses.fields(instance)]
    return type(instance), tuple(values)


def _frozen(array: FloatArray) -> FloatArray:
    """A copy that nobody can make writable: its memory is that of a bytes object."""
    if array.size == 0:
        return read_only(array.copy())
    numbers = np.frombuffer(array.tobytes(), dtype=np.float64)
    return numbers if array.ndim == 1 else numbers.reshape(array.shape)


def _is_frozen(array: NDArray[Any]) -> bool:
    """Whether it is what :func:`_frozen` gives for one dimension: such need no copy."""
    return isinstance(array.base, bytes) and array.dtype == np.float64 and array.ndim == 1


def _frozen_copy(field: str, given: Any) -> FloatArray:
    """A read-only copy of some numbers.

    Raises:
        InvalidInputError: They are something else.
    """
    try:
        array = np.array(given)
        numbers = array.astype(np.float64) if array.dtype.kind in "fiuO" else None
    except (TypeError, ValueError, OverflowError):
        numbers = None
    if numbers is None:
        raise InvalidInputError(field, given, "an array of numbers")
    return _frozen(numbers)


def checked_shape(field: str, shape: ArrayLike, params: SnakeParams) -> FloatArray:
    """A body shape as a read-only float64 array (n,) [rad], if an episode may begin or end with it.

    Raises:
        InvalidInputError: Wrong length, not finite, beyond the joint limits, or self-colliding.
    """
    try:
        phi = _frozen_copy(field, 0.0 if shape is None else shape)
    except InvalidInputError:
        expected = f"{params.n_joints} joint angles [rad]"
        raise InvalidInputError(field, shape, expected) from None
    if phi.shape != (params.n_joints,):
        raise InvalidInputError(
            f"{field}.shape", phi.shape, f"({params.n_joints},), one angle per joint"
        )
    for k, angle in enumerate(phi):
        name = f"{field}[{k}]"
        if not np.isfinite(angle):
            raise InvalidInputError(name, float(angle), "a finite angle [rad]")
        if abs(angle) > params.phi_limit + params.limit_tolerance:
            raise InvalidInputError(
                name, float(angle), f"at most phi_limit = {params.phi_limit:.6f} rad in size"
            )
    distance = d_min(phi, params.l)
    if distance < params.d_collision:
        raise InvalidInputError(
            field,
            np.round(phi, 3).tolist(),
            f"links at least {params.d_collision:.3f} m apart; here d_min = {distance:.3f} m",
        )
    return phi
