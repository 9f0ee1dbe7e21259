"""The robot's and the controller's constants: :class:`SnakeParams` and its presets."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from snake_env.errors import InvalidInputError, UnknownNameError, as_finite, as_integer

N_JOINTS_RANGE = (5, 16)
MAX_STEPS = 1_000_000  # sub-steps in an interval
SMALLEST, LARGEST = 1e-9, 1e6
"""Positive constants are no smaller, and no number is larger in size: their products stay finite."""


@dataclass(frozen=True)
class SnakeParams:
    """Every constant of the robot, its controller and the choice of modes.

    The defaults are the preset ``paper``: Table I of the paper, and what it leaves open as
    ``docs/deviations.md`` closes it. Instances are immutable and hashable.

    Raises:
        InvalidInputError: A field has a wrong type or lies out of its range; the message names it.
    """

    n_joints: int = 8
    """n: yaw joints, and wheel axles behind the head link."""
    l: float = 0.091  # noqa: E741
    """l [m]: half a link's length."""
    track: float = 0.10
    """[m]: distance between the two wheels of an axle, (22)."""
    head_contact: bool = True
    """Whether the wheel-less link 0 rests on the ground, (22)."""

    delta_t: float = 3.0
    """Delta T [s]: switching period of the mode, (4)."""
    dt: float = 0.02
    """[s]: sampling time."""
    horizon: int = 100
    """Intervals after which an episode fails."""
    cam_time: float = 1.5
    """[s]: duration of the reference's cam curve, section III-B."""
    epsilon_p: float = 0.05
    """epsilon_p [rad]: convergence of the SCP, (18)."""

    c_phi: float = math.pi / 4
    """c_phi [rad]: activation of V_L, (19)."""
    d_0: float = 0.27
    """d_0 [m]: activation of V_c, (19)."""
    a_l: float = 2.1
    """a_L: weight of V_L, (19)."""
    a_c: float = 670.0
    """a_c: weight of V_c, (19)."""
    a_s: float = 2e-3
    """a_s: weight of V_s, (19)."""
    det_floor: float = 1e-6
    """Least determinant in V_s: singular shapes stay finite."""
    a_scp: float = 1e-4
    """a_scp: weight of V_scp, (24)."""

    gains: tuple[float, float, float, float] = (1.0, 1.0, 0.5, 2.0)
    """K' [1/s]: x, y, theta, SCP."""
    k_0: float = math.pi / 4
    """k_0 [rad]: activation of k_t, (28)."""
    k_eta: float = 2.0
    """k_eta': gain of the redundant input, (16)."""
    w_d: tuple[float, float, float] = (0.0, 0.0, math.pi)
    """w_d [m, m, rad]: wanted head pose."""
    phi_limit: float = math.pi / 2
    """phi_limit [rad]: joint limit, (23)."""
    u_limit: float = math.pi / 4
    """u_limit [rad/s]: joint speed limit, (30)."""
    limit_tolerance: float = 1e-6
    """[rad]: rounding allowed for in (23)."""

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = _checked_type(field.name, getattr(self, field.name), field.default)
            object.__setattr__(self, field.name, value)
        low, high = N_JOINTS_RANGE
        if not low <= self.n_joints <= high:
            raise InvalidInputError("n_joints", self.n_joints, f"an integer from {low} to {high}")
        for name in _POSITIVE:
            if not getattr(self, name) >= SMALLEST:
                expected = f"a positive number, at least {SMALLEST:g}"
                raise InvalidInputError(name, getattr(self, name), expected)
        for name in _NON_NEGATIVE:
            if not getattr(self, name) >= 0:
                raise InvalidInputError(name, getattr(self, name), "zero or a positive number")
        if min(self.gains) < SMALLEST:
            expected = f"four positive numbers, at least {SMALLEST:g}"
            raise InvalidInputError("gains", self.gains, expected)
        if self.phi_limit >= math.pi:
            raise InvalidInputError("phi_limit", self.phi_limit, "less than pi")
        steps = self.delta_t / self.dt
        if not 1 <= steps <= MAX_STEPS or abs(steps - round(steps)) > 1e-9 * steps:
            raise InvalidInputError("dt", self.dt, f"a divisor of delta_t = {self.delta_t}")

    @classmethod
    def preset(cls, name: str, **overrides: Any) -> SnakeParams:
        """The constants of a named preset, with some of them replaced.

        Args:
            name: ``paper`` (Table I), ``hardware`` (section VI), ``narrow`` (as ``paper``, but link 0
                does not touch the ground), ``six`` or ``ten`` (as ``paper``, with 6 or 10 joints).
            **overrides: Fields to replace.

        Raises:
            UnknownNameError: No such preset or field.
            InvalidInputError: A replaced field is out of its range.
        """
        if not isinstance(name, str) or name not in PRESETS:
            raise UnknownNameError("preset", str(name), PRESETS)
        return cls().replace(**{**PRESETS[name], **overrides})

    def replace(self, **overrides: Any) -> SnakeParams:
        """A copy with some fields replaced.

        Raises:
            UnknownNameError: No such field.
            InvalidInputError: A value is out of its field's range.
        """
        known = [field.name for field in dataclasses.fields(self)]
        for key in overrides:
            if key not in known:
                raise UnknownNameError("parameter", key, known)
        return dataclasses.replace(self, **overrides)

    def differences(self, other: SnakeParams) -> dict[str, tuple[Any, Any]]:
        """The fields in which others differ: their values here and there."""
        names = [field.name for field in dataclasses.fields(self)]
        pairs = {name: (getattr(self, name), getattr(other, name)) for name in names}
        return {name: pair for name, pair in pairs.items() if pair[0] != pair[1]}

    @property
    def n_steps(self) -> int:
        """Sub-steps in one interval: delta_t / dt."""
        return round(self.delta_t / self.dt)

    @property
    def d_collision(self) -> float:
        """Least d_min [m] of an initial or target shape: 2 l, so that no links can overlap."""
        return 2.0 * self.l

    @property
    def d_touch(self) -> float:
        """d_min [m] under which moving links touch for certain: a link is as wide as its axle."""
        return self.track

    @property
    def horizon_s(self) -> float:
        """Longest duration of an episode [s]."""
        return self.horizon * self.delta_t


PRESETS: Mapping[str, Mapping[str, Any]] = {
    "paper": {},
    "hardware": {"dt": 0.2, "a_c": 67.0, "gains": (1.0, 1.0, 0.5, 0.5), "k_eta": 1.0},
    "narrow": {"head_contact": False},
    "six": {"n_joints": 6},
    "ten": {"n_joints": 10},
}

_POSITIVE = (
    *("l", "track", "delta_t", "dt", "horizon", "cam_time", "epsilon_p", "c_phi", "d_0"),
    *("det_floor", "k_0", "phi_limit", "u_limit"),
)
_NON_NEGATIVE = ("a_l", "a_c", "a_s", "a_scp", "k_eta", "limit_tolerance")


def _checked_type(name: str, value: Any, default: Any) -> Any:
    """The value as the default's type; a tuple's length must match, numbers must be finite."""
    if isinstance(default, bool):
        if not isinstance(value, bool):
            raise InvalidInputError(name, value, "True or False")
        return value
    if isinstance(default, int):
        integer = as_integer(value)
        if integer is None or abs(integer) > LARGEST:
            raise InvalidInputError(name, value, f"an integer, at most {LARGEST:.0f}")
        return integer
    if isinstance(default, tuple):
        is_sequence = hasattr(value, "__len__") and not isinstance(value, (str, bytes))
        numbers = tuple(map(as_finite, value)) if is_sequence else ()
        if len(numbers) != len(default) or not all(map(_is_usable, numbers)):
            expected = f"{len(default)} finite numbers, at most {LARGEST:g} in size"
            raise InvalidInputError(name, value, expected)
        return numbers
    number = as_finite(value)
    if not _is_usable(number):
        raise InvalidInputError(name, value, f"a finite number, at most {LARGEST:g} in size")
    return number


def _is_usable(number: float | None) -> bool:
    return number is not None and abs(number) <= LARGEST


def parse_overrides(assignments: Iterable[str]) -> dict[str, Any]:
    """Constants from ``NAME=VALUE`` texts, as in ``a_c=67``, ``gains=1,1,0.5,1.5``.

    Raises:
        InvalidInputError: A text has another form.
    """
    pairs: dict[str, Any] = {}
    for assignment in assignments:
        name, equals, text = assignment.partition("=")
        if name in pairs:
            raise InvalidInputError("set", assignment, f"{name} only once")
        listed = f"[{text}]" if "," in text and "[" not in text else text
        try:
            pairs[name] = json.loads(listed.lower())
        except (ValueError, RecursionError):
            equals = ""
        if not equals:
            expected = (
                "NAME=VALUE; a value is a number, numbers with commas between them, true or false"
            )
            raise InvalidInputError("set", assignment, expected)
    return pairs
