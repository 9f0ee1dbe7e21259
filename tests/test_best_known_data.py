"""The plans that ship are plans."""

import numpy as np
import pytest

from agents.best_known import replay
from snake_env import SnakeParams, UnknownNameError
from snake_env.best_known import best_known
from snake_env.tasks import FROZEN, load_tasks

PARAMS = SnakeParams()


def test_plans__lead_to_the_target_in_the_time_they_say() -> None:
    suite, known = load_tasks("paper-500", PARAMS), best_known("paper-500")
    assert len(known.time_s) == len(known.modes) == FROZEN["paper-500"][0]
    assert np.isfinite(known.time_s).all()
    for task in range(0, 500, 10):
        plan = replay(suite.initial(task, PARAMS), known.modes[task], PARAMS)
        assert (plan is not None) == bool(np.isfinite(known.time_s[task]))
        if plan is not None:
            assert len(plan) * PARAMS.delta_t == known.time_s[task]
            assert plan.cost == pytest.approx(known.cost[task], abs=1e-5)


def test_suite__without_plans_is_refused() -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'paper-500'"):
        best_known("paper-50")
