"""Tasks: pairs of an initial and a target shape, from named suites, seeds or files."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from snake_env.errors import InvalidInputError, UnknownNameError, as_integer
from snake_env.params import SnakeParams
from snake_env.sim.array_file import ArrayFileError, read_arrays
from snake_env.sim.simulation import least_distances
from snake_env.state import FloatArray, SnakeState, checked_shape

_PAPER_SHAPES = (SnakeParams().l, SnakeParams().phi_limit)
# Simulation 1 of the paper, section V. Its -1.57 rad is within the limit of pi/2.
_SIM_1 = (
    (0.63, -0.44, -1.57, -0.36, -0.57, -0.34, -1.00, -0.91),
    (0.29, 0.30, -1.02, 1.36, -1.39, -0.94, 0.025, 0.81),
)
FROZEN = {
    "paper-500": (
        500,
        0,
        {8: "fb0e3fa6b67448d29b9a1f63ea29e34fabe3ae9f69195b7293fae39d68e23489"},
    ),
    "validation-2k": (
        2000,
        7_002_000,
        {8: "5e67b18d7b31b09b314911da6ed3937b57db7193805461465dd0c71c7617e65d"},
    ),
    "test-2k": (
        2000,
        7_012_000,
        {
            6: "067343ee92224e2929561b0d71e8ae948cb28cc89fdf2bf06f83f86db70783cf",
            8: "50feff7bf4eb762404bde338d8c837bea7bd07507eaf13b013ed1efbb27091a4",
            10: "1d3ca313559206ffd761c785283bada3dd0e72fbf50641dd5c8bd7ef9d7676f8",
        },
    ),
    "test-10k": (
        10_000,
        7_010_000,
        {8: "ddafc98c9a2d745a1e6a8e0940786d320f20164a0286dd9dd5a065cacdf60d25"},
    ),
}
"""Suites that never change: their size, their seed, and the SHA-256 of their tasks by joints.

Each has a seed of its own, so they share no task. Nothing is ever trained or tuned on ``test-2k`` and
``test-10k``.
"""
SUITES = (*FROZEN, "sim-1", "random:N[:SEED]", "FILE.npz")
"""What :func:`load_tasks` knows: the frozen suites, the paper's first simulation (Fig. 5), random
tasks, and files."""

_AT_A_TIME = 1000
"""Tasks of a suite that are drawn together: a source of random numbers takes two kilobytes."""


@dataclass(frozen=True, eq=False)
class TaskSuite:
    """Tasks to evaluate on.

    Attributes:
        name: The name that :func:`load_tasks` was given.
        phi0: Initial shapes, shape (N, n) [rad].
        target: Target shapes, shape (N, n) [rad].
    """

    name: str
    phi0: FloatArray
    target: FloatArray

    def __len__(self) -> int:
        return len(self.phi0)

    @property
    def sha256(self) -> str:
        """Digest of the shapes."""
        shapes = np.concatenate([self.phi0, self.target]).astype("<f8")
        return hashlib.sha256(shapes.tobytes()).hexdigest()

    def initial(self, task: int, params: SnakeParams) -> SnakeState:
        """The state in which a task begins.

        Args:
            task: Its row, 0 to N - 1.
            params: The constants.

        Raises:
            InvalidInputError: There is no such row, or its shapes do not fit the constants.
        """
        row = as_integer(task)
        if row is None or not 0 <= row < len(self):
            raise InvalidInputError("task", task, f"a row from 0 to {len(self) - 1}")
        return SnakeState.initial(self.phi0[row], self.target[row], params)


def random_tasks(
    rngs: Sequence[np.random.Generator], params: SnakeParams
) -> tuple[FloatArray, FloatArray]:
    """Random tasks as in section V, one from each source of randomness.

    Shapes are uniform within the joint limits and drawn again where d_min < 2 l. A task depends on its
    own source only.

    Args:
        rngs: N sources of randomness; first the initial, then the target shape is drawn from each.
        params: The constants; shapes depend on ``n_joints``, ``l`` and ``phi_limit``.

    Returns:
        Initial and target shapes, each (N, n) [rad].
    """
    return _random_shapes(rngs, params), _random_shapes(rngs, params)


def _random_shapes(rngs: Sequence[np.random.Generator], params: SnakeParams) -> FloatArray:
    shapes = np.empty((len(rngs), params.n_joints))
    colliding = np.arange(len(rngs))
    while len(colliding):
        for k in colliding.tolist():
            shapes[k] = rngs[k].uniform(-params.phi_limit, params.phi_limit, params.n_joints)
        distances = least_distances(shapes[colliding], params)
        colliding = colliding[distances < params.d_collision]
    return shapes


def random_suite(count: int, seed: int, params: SnakeParams, name: str | None = None) -> TaskSuite:
    """Random tasks, each from a stream of its own: task k of a seed is the same in any suite size.

    Args:
        count: Number of tasks.
        seed: Non-negative seed of the suite.
        params: The constants; shapes depend on ``n_joints``, ``l`` and ``phi_limit``.
        name: Name of the suite.
    """
    parts = []
    for first in range(0, count, _AT_A_TIME):
        tasks = range(first, min(first + _AT_A_TIME, count))
        streams = [np.random.SeedSequence(seed, spawn_key=(task,)) for task in tasks]
        parts.append(random_tasks([np.random.default_rng(stream) for stream in streams], params))
    phi0, target = (np.concatenate(shapes) for shapes in zip(*parts, strict=True))
    return TaskSuite(name or f"random:{count}:{seed}", phi0, target)


def _frozen_suite(name: str, params: SnakeParams) -> TaskSuite:
    """A frozen suite; where its digest is known it is checked that NumPy still draws the same tasks."""
    count, seed, digests = FROZEN[name]
    suite = random_suite(count, seed, params, name)
    digest = digests.get(params.n_joints, suite.sha256)
    if (params.l, params.phi_limit) == _PAPER_SHAPES and suite.sha256 != digest:
        expected = f"a version that draws the tasks of {name}"
        raise InvalidInputError("numpy", np.__version__, expected)
    return suite


def load_tasks(name: str | Path, params: SnakeParams) -> TaskSuite:
    """The tasks of a suite: one of :data:`SUITES`.

    Args:
        name: The suite's name, or the file's path. A file holds ``phi0`` and ``target``, both of
            shape (N, n) [rad]; it is read without pickle.
        params: The constants.

    Raises:
        UnknownNameError: No such suite.
        InvalidInputError: A malformed file or a bad task; the message names the row.
    """
    text = str(name)
    if text in FROZEN:
        return _frozen_suite(text, params)
    if text == "sim-1":
        if params.n_joints != len(_SIM_1[0]):
            raise InvalidInputError("n_joints", params.n_joints, "8 for the suite sim-1")
        phi0, target = (checked_shape(f"{text}: shape", shape, params) for shape in _SIM_1)
        return TaskSuite(text, phi0[None], target[None])
    if text.startswith("random:"):
        match = re.fullmatch(r"random:(\d{1,9})(?::(\d{1,18}))?", text)
        if match is None or int(match[1]) == 0:
            raise InvalidInputError("tasks", text, "random:N or random:N:SEED, with N at least 1")
        return random_suite(int(match[1]), int(match[2] or 0), params, text)
    if text.endswith(".npz"):
        return _read_tasks(Path(text), params)
    raise UnknownNameError("task suite", text, SUITES)


def _read_tasks(path: Path, params: SnakeParams) -> TaskSuite:
    if not os.path.isfile(path):
        raise InvalidInputError("tasks", str(path), "a file that exists")
    wanted = f"(N, {params.n_joints})"
    try:
        arrays = read_arrays(path, "phi0", "target")
    except ArrayFileError as error:
        expected = f"an .npz file with arrays phi0 and target of shape {wanted} ({error})"
        raise InvalidInputError("tasks", str(path), expected) from None
    for key, array in arrays.items():
        if array.ndim != 2 or array.shape[1] != params.n_joints:
            expected = f"numbers of shape {wanted}"
            raise InvalidInputError(f"{key} in {path}", f"{array.dtype} {array.shape}", expected)
    if len(arrays["phi0"]) != len(arrays["target"]) or len(arrays["phi0"]) == 0:
        rows = (len(arrays["phi0"]), len(arrays["target"]))
        raise InvalidInputError(
            f"rows of phi0, target in {path}", rows, "as many of each, at least 1"
        )
    shapes = {
        key: [
            checked_shape(f"{path}: {key}[{row}]", values, params)
            for row, values in enumerate(arrays[key])
        ]
        for key in ("phi0", "target")
    }
    return TaskSuite(str(path), np.array(shapes["phi0"]), np.array(shapes["target"]))
