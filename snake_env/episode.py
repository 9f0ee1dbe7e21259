"""What happens to a whole episode: when it ends, how, and the figures that describe it.

The env and ``python -m evaluate`` both take their figures from here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from snake_env.params import SnakeParams
from snake_env.simulation import Prediction
from snake_env.state import SnakeState

OUTCOMES = ("success", "deadlock", "horizon", "stability", "joint_limit", "collision", "error")
"""How an episode can end; all but the first are failures.

``deadlock``: no mode was feasible, or the robot stood still when the horizon was reached.
``horizon``: it still moved then. ``stability``, ``joint_limit``: the policy chose a mode that breaks
(22) or (23) although another was feasible. ``collision``: links touched. ``error``: the policy raised.
"""

STILL = 1e-3
"""A robot stands still if no joint turns by more than this in an interval [rad]."""


@dataclass(frozen=True)
class EpisodeSummary:
    """Figures of an episode, so far or at its end.

    Attributes:
        outcome: One of :data:`OUTCOMES`; empty while the episode goes on.
        intervals: Decisions made.
        time_s: Duration [s].
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
    phase: int
    cost_integral: float
    d_min: float
    max_abs_phi: float
    head_error_m: float
    head_error_rad: float


class Episode:
    """Follows an episode interval by interval.

    Attributes:
        outcome: One of :data:`OUTCOMES` once the episode has ended; empty before.
    """

    def __init__(self, state: SnakeState, params: SnakeParams) -> None:
        self.params = params
        self.outcome = "success" if state.done else ""
        self._state = state
        self._intervals = 0
        self._cost = 0.0
        self._d_min = np.inf
        self._max_abs_phi = float(np.abs(state.phi).max())
        self._head_error_m = 0.0
        self._head_error_rad = 0.0

    @property
    def ended(self) -> bool:
        """Whether the episode is over."""
        return bool(self.outcome)

    def record(self, after: SnakeState, prediction: Prediction) -> None:
        """Takes note of an executed interval (one lane) and of the state that it led to."""
        moved = float(np.abs(after.phi - self._state.phi).max())
        self._state = after
        self._intervals += 1
        self._cost += float(prediction.cost[0])
        self._d_min = min(self._d_min, float(prediction.d_min[0]))
        self._max_abs_phi = max(self._max_abs_phi, float(prediction.max_abs_phi[0]))
        error = after.w - self.params.w_d
        self._head_error_m = max(self._head_error_m, float(np.hypot(error[0], error[1])))
        self._head_error_rad = max(self._head_error_rad, abs(float(error[2])))
        violation = str(prediction.violation[0])
        if violation:
            self.outcome = violation
        elif prediction.d_min[0] < self.params.d_touch:
            self.outcome = "collision"
        elif after.done:
            self.outcome = "success"
        elif self._intervals >= self.params.horizon:
            self.outcome = "deadlock" if moved < STILL else "horizon"

    def summary(self) -> EpisodeSummary:
        """The figures so far."""
        return EpisodeSummary(
            outcome=self.outcome,
            intervals=self._intervals,
            time_s=self._state.elapsed,
            phase=self._state.phase,
            cost_integral=self._cost,
            d_min=self._d_min,
            max_abs_phi=self._max_abs_phi,
            head_error_m=self._head_error_m,
            head_error_rad=self._head_error_rad,
        )
