"""Attributes and methods of each env, as ``SyncVectorEnv`` gives them, for robots that share one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from snake_env.envs.vector_env import SnakeModeSelectionVectorEnv


def of_each_robot(envs: SnakeModeSelectionVectorEnv, name: str) -> tuple[Any, ...]:
    """A method's result or an attribute, robot by robot.

    Raises:
        AttributeError: The robots have none of this name.
    """
    count = envs.num_envs
    rows: dict[str, Callable[[], Sequence[Any]]] = {
        "action_masks": lambda: list(envs.action_masks()),
        "state": lambda: [envs.core.states[k] for k in range(count)],
        "np_random": lambda: envs.np_random,
        "np_random_seed": lambda: envs.np_random_seed,
        "render": lambda: envs.render() or (None,) * count,
    }
    same = {
        "params": envs.params,
        "action_space": envs.single_action_space,
        "observation_space": envs.single_observation_space,
        "render_mode": envs.render_mode,
        "metadata": envs.metadata,
        "spec": envs.spec,
    }
    if name in same:
        return (same[name],) * count
    if name not in rows:
        known = ", ".join(sorted((*rows, *same)))
        raise AttributeError(f"the robots have no attribute {name!r}; known: {known}")
    return tuple(rows[name]())
