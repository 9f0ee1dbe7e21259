"""What happens to a whole episode: when it ends, how, and the figures that describe it.

The env and ``python -m evaluate`` both take their figures from here.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from snake_env.params import SnakeParams
from snake_env.sim.simulation import Prediction, any_feasible, least_distances
from snake_env.state import FloatArray, IntArray, SnakeState, StateBatch

OUTCOMES = ("success", "deadlock", "horizon", "stability", "joint_limit", "collision", "error")
"""How an episode can end; all but the first are failures.

``deadlock``: no mode was feasible, or the robot stood still when the horizon was reached.
``horizon``: it still moved then. ``stability``, ``joint_limit``: the policy chose a mode that breaks
(22) or (23) although another was feasible. ``collision``: links touched. ``error``: the policy raised.
"""

_FIGURES = ("cost_integral", "d_min", "max_abs_phi", "head_error_m", "head_error_rad")

STILL = 1e-3
"""A robot stands still if no joint turns by more than this in an interval [rad]."""


def has_moved(phase: int, phi: FloatArray, state: SnakeState) -> bool:
    """Whether a robot has left the phase and the shape (n,) [rad] that it once had."""
    turned = abs(state.last_turn) >= STILL or np.abs(state.phi - phi).max() >= STILL
    return phase != state.phase or bool(turned)


def have_moved(phases: IntArray, phi: FloatArray, states: StateBatch) -> NDArray[np.bool_]:
    """:func:`has_moved` of N robots, for phases (N,) and shapes (N, n) [rad]."""
    turned = (np.abs(states.last_turn) >= STILL) | (np.abs(states.phi - phi).max(axis=1) >= STILL)
    moved: NDArray[np.bool_] = turned | (states.phase != phases)
    return moved


@dataclass(frozen=True)
class EpisodeSummary:
    """Figures of an episode, so far or at its end.

    Attributes:
        outcome: One of :data:`OUTCOMES`; empty while the episode is running.
        intervals: Decisions made.
        time_s: Duration [s].
        shape_error_rad: Largest error of a joint, now or at the end: max |phi_i - target_i| [rad].
        phase: Phase at the end; n + 1 after a success.
        cost_integral: Integral of V (19) [s].
        d_min: Least distance between links that could collide [m].
        max_abs_phi: Largest joint angle in size [rad].
        head_error_m: Largest distance of the head from where it should be, at any t_k [m].
        head_error_rad: Largest error of its heading, at any t_k [rad].
    """

    outcome: str
    intervals: int
    time_s: float
    shape_error_rad: float
    phase: int
    cost_integral: float
    d_min: float
    max_abs_phi: float
    head_error_m: float
    head_error_rad: float


class Episodes:
    """Follows many episodes interval by interval.

    Attributes:
        outcome: One of :data:`OUTCOMES` for each that has ended, else empty, shape (N,).
    """

    def __init__(self, states: StateBatch, params: SnakeParams) -> None:
        self.params = params
        count = len(states)
        self.outcome = np.zeros(count, dtype="<U12")
        self._intervals = np.zeros(count, dtype=np.int64)
        self._figures = {name: np.zeros(count) for name in _FIGURES}
        self._states = states
        self.restart(np.arange(count), states)

    def restart(self, indices: IntArray, states: StateBatch, behind: IntArray | int = 0) -> None:
        """Begins episodes at the given positions, which have some intervals behind them."""
        self._states = self._states.put(indices, states)
        self.outcome[indices] = np.where(states.phase > self.params.n_joints, "success", "")
        self._intervals[indices] = behind
        for values in self._figures.values():
            values[indices] = 0.0
        self._figures["d_min"][indices] = least_distances(states.phi, self.params)
        self._figures["max_abs_phi"][indices] = np.abs(states.phi).max(axis=1)
        self._note_head_error(indices, states)

    def record(self, indices: IntArray, after: StateBatch, prediction: Prediction) -> None:
        """Records executed intervals, one lane each, and the states that they led to."""
        before = self._states.phi[indices]
        self._states = self._states.put(indices, after)
        self._intervals[indices] += 1
        figures = self._figures
        figures["cost_integral"][indices] += prediction.cost
        for name, combine, values in (
            ("d_min", np.minimum, prediction.d_min),
            ("max_abs_phi", np.maximum, prediction.max_abs_phi),
        ):
            figures[name][indices] = combine(figures[name][indices], values)
        self._note_head_error(indices, after)
        moved = np.abs(after.phi - before).max(axis=1)
        late = self._intervals[indices] >= self.params.horizon
        over = late | (after.phase > self.params.n_joints)
        over |= (prediction.d_min < self.params.d_touch) | ~prediction.feasible
        for k in np.flatnonzero(over).tolist():  # few of many: comparing texts takes time
            if prediction.violation[k]:
                outcome = prediction.violation[k]
            elif prediction.d_min[k] < self.params.d_touch:
                outcome = "collision"
            elif after.phase[k] > self.params.n_joints:
                outcome = "success"
            elif late[k]:
                outcome = "deadlock" if moved[k] < STILL else "horizon"
            else:
                continue  # a rejected choice
            self.outcome[indices[k]] = outcome

    def d_min(self, indices: IntArray) -> FloatArray:
        """Least distances between links so far, at the given positions [m]."""
        distances: FloatArray = self._figures["d_min"][indices]
        return distances

    def _note_head_error(self, indices: IntArray, states: StateBatch) -> None:
        x, y, theta = (states.w - self.params.w_d).T
        for name, size in (("head_error_m", np.hypot(x, y)), ("head_error_rad", np.abs(theta))):
            self._figures[name][indices] = np.maximum(self._figures[name][indices], size)

    def columns(self, indices: IntArray) -> dict[str, NDArray[Any]]:
        """The figures of some episodes so far: the fields of :class:`EpisodeSummary`, in arrays."""
        columns = {
            "outcome": self.outcome,
            "intervals": self._intervals,
            "time_s": self._states.elapsed,
            "shape_error_rad": np.abs(self._states.phi - self._states.target).max(axis=1),
            "phase": self._states.phase,
            **self._figures,
        }
        return {name: values[indices] for name, values in columns.items()}

    def summary(self, k: int) -> EpisodeSummary:
        """The figures of one episode so far."""
        columns = self.columns(np.array([k]))
        return EpisodeSummary(**{name: values[0].item() for name, values in columns.items()})


class Episode:
    """Follows one episode interval by interval.

    Attributes:
        outcome: One of :data:`OUTCOMES` once the episode has ended; empty before.
    """

    def __init__(self, state: SnakeState, params: SnakeParams) -> None:
        self._episodes = Episodes(StateBatch.stack([state]), params)
        self.outcome = str(self._episodes.outcome[0])

    def record(self, after: SnakeState, prediction: Prediction) -> None:
        """Records an executed interval, one lane, and the state that it led to."""
        self._episodes.record(np.array([0]), StateBatch.stack([after]), prediction)
        self.outcome = str(self._episodes.outcome[0])

    def take(self, before: SnakeState, after: SnakeState, prediction: Prediction) -> bool:
        """Records an interval that a policy chose, or ends where no mode was feasible.

        Returns:
            Whether it was recorded.
        """
        if prediction.violation[0] and not any_feasible(before, self._episodes.params):
            self.end("deadlock")
            return False
        self.record(after, prediction)
        return True

    def end(self, outcome: str) -> None:
        """Ends the episode with an outcome that its motion does not show: ``deadlock``, ``error``."""
        self._episodes.outcome[0] = self.outcome = outcome

    def summary(self) -> EpisodeSummary:
        """The figures so far."""
        return self._episodes.summary(0)
