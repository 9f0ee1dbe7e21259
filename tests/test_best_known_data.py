"""The plans that ship are plans."""

import numpy as np
import pytest

from agents.best_known import replay
from snake_env import SnakeParams, UnknownNameError
from snake_env.best_known import best_known
from snake_env.tasks import FROZEN, load_tasks

PARAMS = SnakeParams()


@pytest.mark.parametrize(("name", "unsolved"), [("paper-500", 0), ("validation-2k", 10)])
def test_plans__lead_to_the_target_in_the_time_they_say(name: str, unsolved: int) -> None:
    suite, known = load_tasks(name, PARAMS), best_known(name)
    count = FROZEN[name][0]
    assert len(known.time_s) == len(known.modes) == count
    assert np.sum(~np.isfinite(known.time_s)) <= unsolved
    for task in range(0, count, count // 50):
        plan = replay(suite.initial(task, PARAMS), known.modes[task], PARAMS)
        assert (plan is not None) == bool(np.isfinite(known.time_s[task]))
        if plan is not None:
            assert len(plan) * PARAMS.delta_t == known.time_s[task]
            assert plan.cost == pytest.approx(known.cost[task], abs=1e-5)


def test_suite__without_plans_is_refused() -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'paper-500'"):
        best_known("paper-50")
