"""Task suites: streams of their own, frozen suites, files, and what is refused."""

import functools
import hashlib
import pickle
import re
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from snake_env.errors import InvalidInputError, UnknownNameError
from snake_env.kernel.distance import d_min
from snake_env.params import SnakeParams
from snake_env.sim import tasks
from snake_env.sim.tasks import FROZEN, SUITES, TaskSuite, load_tasks, random_suite
from tests.support.damage import PickleBomb
from tests.support.robots import PAPER

GOOD = np.linspace(-0.3, 0.3, 24).reshape(3, 8)
DIGESTS = {  # of the angles in units of 1e-9 rad: no machine's last digit matters
    "paper-500": "c92640e23d6ab761f44a2d7535b69d5f96d0e4848b086fcc486306764963e650",
    "validation-2k": "1c8aa7a840110093f65169dbb6700a48c92089d853dbb6abaf9d259d6dd96fc7",
    "test-2k": "3f04b012703517df8066838a7338aacf85a68dbe0c3d20e4c55965cc7f46a439",
    "test-10k": "f3f03f4768e3e8b53644e29a6a2e55739b181e419f9755a87b4861fa5ee3a609",
}


def _same(a: TaskSuite, b: TaskSuite) -> bool:
    return np.array_equal(a.phi0, b.phi0) and np.array_equal(a.target, b.target)


def test_sim_1__is_the_papers() -> None:
    suite = load_tasks("sim-1", PAPER)
    assert len(suite) == 1
    assert suite.phi0.tolist() == [[0.63, -0.44, -1.57, -0.36, -0.57, -0.34, -1.00, -0.91]]
    assert suite.target.tolist() == [[0.29, 0.30, -1.02, 1.36, -1.39, -0.94, 0.025, 0.81]]


def test_sim_1__needs_eight_joints() -> None:
    with pytest.raises(InvalidInputError, match=r"^n_joints = 6: expected 8"):
        load_tasks("sim-1", SnakeParams(n_joints=6))


@functools.cache
def _frozen(name: str) -> TaskSuite:
    return load_tasks(name, PAPER)


@pytest.mark.parametrize(
    ("name", "same"),
    [
        ("paper-500", "random:500:0"),
        ("validation-2k", "random:2000:7002000"),
        ("test-2k", "random:2000:7012000"),
        ("test-10k", "random:10000:7010000"),
    ],
)
def test_frozen_suite__never_changes(name: str, same: str) -> None:
    suite = _frozen(name)
    assert suite.name == name
    assert _same(suite, load_tasks(same, PAPER))
    rounded = np.rint(np.stack([suite.phi0, suite.target]) * 1e9).astype("<i8")
    assert hashlib.sha256(rounded.tobytes()).hexdigest() == DIGESTS[name]
    assert DIGESTS.keys() == FROZEN.keys() < set(SUITES)


def test_frozen_suites__share_no_shape() -> None:
    shapes = np.concatenate([part for name in FROZEN for part in _shapes(_frozen(name))])
    assert shapes.shape == (2 * 14_500, 8)
    assert len(np.unique(shapes, axis=0)) == 2 * 14_500
    assert len(np.unique(shapes[:, 0])) == 2 * 14_500  # not even an angle


def _shapes(suite: TaskSuite) -> tuple[np.ndarray, np.ndarray]:
    return suite.phi0, suite.target


@pytest.mark.parametrize("name", FROZEN)
def test_frozen_suite__that_is_drawn_differently_is_refused(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    count, seed, digests = FROZEN[name]
    drawn = _frozen(name)

    def random_suite(count: int, seed: int, params: SnakeParams, name: str) -> TaskSuite:
        return TaskSuite(name, drawn.phi0, target)

    monkeypatch.setattr(tasks, "random_suite", random_suite)
    target = drawn.target.copy()
    assert _same(load_tasks(name, PAPER), drawn)
    target[count // 2, 3] = np.nextafter(target[count // 2, 3], 1.0)
    message = rf"^numpy = '{np.__version__}': expected a version that draws the tasks of {name}$"
    with pytest.raises(InvalidInputError, match=message):
        load_tasks(name, PAPER)
    target[:] = drawn.target
    monkeypatch.setitem(FROZEN, name, (count, seed, {8: digests[8][::-1]}))
    with pytest.raises(InvalidInputError, match=message):
        load_tasks(name, PAPER)


@pytest.mark.parametrize("n_joints", [6, 10])
def test_frozen_suite__is_frozen_for_the_other_presets_too(
    n_joints: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    params = SnakeParams(n_joints=n_joints)
    drawn = load_tasks("test-2k", params)
    assert _same(drawn, load_tasks("random:2000:7012000", params))
    monkeypatch.setattr(tasks, "random_suite", lambda *_: TaskSuite("", drawn.phi0, -drawn.target))
    with pytest.raises(
        InvalidInputError, match=r"expected a version that draws the tasks of test-2k$"
    ):
        load_tasks("test-2k", params)


@pytest.mark.parametrize("params", [SnakeParams(n_joints=6), SnakeParams(phi_limit=1.2)])
def test_frozen_suite__exists_for_other_robots_too(params: SnakeParams) -> None:
    suite = load_tasks("paper-500", params)
    assert suite.phi0.shape == (500, params.n_joints)
    assert _same(suite, load_tasks("random:500:0", params))
    assert np.abs(suite.phi0).max() <= params.phi_limit


def test_random_task__is_the_same_in_suites_of_any_size() -> None:
    large, small = random_suite(40, 7, PAPER), random_suite(9, 7, PAPER)
    assert np.array_equal(large.phi0[:9], small.phi0)
    assert np.array_equal(large.target[:9], small.target)


def test_random_tasks__differ_between_seeds_and_within_a_suite() -> None:
    suites = [random_suite(10, seed, PAPER) for seed in range(3)]
    shapes = np.concatenate([array for suite in suites for array in (suite.phi0, suite.target)])
    assert len(np.unique(shapes, axis=0)) == 60


@pytest.mark.parametrize("n", [5, 8, 12])
def test_random_shapes__keep_the_limits_and_their_distance(n: int) -> None:
    params = SnakeParams(n_joints=n, phi_limit=1.4)
    suite = random_suite(100, 3, params)
    shapes = np.concatenate([suite.phi0, suite.target])
    assert shapes.shape == (200, n)
    assert 1.3 < np.abs(shapes).max() <= 1.4
    assert min(d_min(phi, params.l) for phi in shapes) >= 2 * params.l


def test_random_shapes__are_uniform_before_rejection() -> None:
    suite = random_suite(2000, 1, SnakeParams(n_joints=5))
    first = suite.phi0[:, 0]  # turns link 0 against all the rest: hardly ever rejected
    assert abs(first.mean()) < 0.06
    assert first.std() == pytest.approx(np.pi / np.sqrt(12), rel=0.05)


@pytest.mark.parametrize(
    ("name", "same"), [("random:4", (4, 0)), ("random:4:0", (4, 0)), ("random:3:12", (3, 12))]
)
def test_random_suite__is_named_by_number_and_seed(name: str, same: tuple[int, int]) -> None:
    suite = load_tasks(name, PAPER)
    assert suite.name == name
    assert _same(suite, random_suite(*same, PAPER))


def test_suite__gives_the_state_in_which_a_task_begins() -> None:
    suite = random_suite(3, 0, PAPER)
    state = suite.initial(2, PAPER)
    assert np.array_equal(state.phi, suite.phi0[2])
    assert np.array_equal(state.target, suite.target[2])
    assert (state.phase, state.elapsed, state.ref_start) == (1, 0.0, suite.phi0[2, 0])


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_file__gives_its_tasks(tmp_path: Path, save: Callable[..., None]) -> None:
    path = tmp_path / "own.npz"
    save(path, phi0=GOOD, target=-GOOD, note=np.arange(3))
    for name in (path, str(path)):
        suite = load_tasks(name, PAPER)
        assert (suite.name, len(suite)) == (str(path), 3)
        assert np.array_equal(suite.phi0, GOOD)
        assert np.array_equal(suite.target, -GOOD)


def test_file__may_hold_integers_and_single_precision(tmp_path: Path) -> None:
    path = tmp_path / "own.npz"
    np.savez(path, phi0=np.zeros((2, 8), dtype=int), target=np.full((2, 8), 0.25, dtype=np.float32))
    suite = load_tasks(path, PAPER)
    assert suite.phi0.dtype == suite.target.dtype == np.float64
    assert suite.target[1, 7] == 0.25


def _row(row: int, column: int, value: float) -> np.ndarray:
    shapes = GOOD.copy()
    shapes[row, column] = value
    return shapes


@pytest.mark.parametrize(
    ("arrays", "named"),
    [
        ({"phi0": GOOD}, "no array target"),
        ({"target": GOOD}, "no array phi0"),
        ({"phi0": GOOD[:, :7], "target": GOOD}, "phi0"),
        ({"phi0": np.zeros((3, 9)), "target": np.zeros((3, 9))}, "(N, 8)"),
        ({"phi0": GOOD, "target": GOOD[0]}, "target"),
        ({"phi0": GOOD, "target": GOOD.astype(str)}, "target"),
        ({"phi0": GOOD > 0, "target": GOOD}, "phi0"),
        ({"phi0": GOOD * 1j, "target": GOOD}, "phi0"),
        ({"phi0": GOOD[:2], "target": GOOD}, "(2, 3)"),
        ({"phi0": GOOD[:0], "target": GOOD[:0]}, "(0, 0)"),
        ({"phi0": _row(1, 4, np.nan), "target": GOOD}, "phi0[1][4] = nan: expected a finite angle"),
        (
            {"phi0": GOOD, "target": _row(2, 0, 2.5)},
            "target[2][0] = 2.5: expected at most phi_limit",
        ),
        ({"phi0": GOOD, "target": np.vstack([GOOD[:2], np.full(8, 1.5)])}, "target[2]"),
        ({"phi0": np.array([{}, 1], dtype=object), "target": GOOD}, "pickle"),
    ],
)
def test_file__with_bad_arrays_is_refused(
    tmp_path: Path, arrays: dict[str, np.ndarray], named: str
) -> None:
    path = tmp_path / "own.npz"
    np.savez(path, **arrays)
    with pytest.raises(InvalidInputError) as caught:
        load_tasks(path, PAPER)
    assert named in str(caught.value)
    assert "\n" not in str(caught.value)


def _npy(array: np.ndarray, path: Path) -> bytes:
    np.save(path.with_suffix(".npy"), array)
    return path.with_suffix(".npy").read_bytes()


def _zipped(path: Path, content: bytes) -> bytes:
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("phi0.npy", content)
        file.writestr("target.npy", content)
    return path.read_bytes()


def _good(path: Path, save: Callable[..., None] = np.savez) -> bytes:
    shapes = np.random.default_rng(0).uniform(-0.2, 0.2, (2, 100, 8))
    save(path, phi0=shapes[0], target=shapes[1])
    return path.read_bytes()


def _flipped(data: bytes) -> bytes:
    return bytes(byte ^ 0xFF if 200 <= k < 1000 else byte for k, byte in enumerate(data))


HUGE = b"\x93NUMPY\x01\x00v\x00{'descr': '<f8', 'fortran_order': False, 'shape': (10**14, 8), }"
DAMAGES: dict[str, Callable[[Path], bytes]] = {
    "empty": lambda path: b"",
    "text": lambda path: b"phi0, target\n",
    "pickle": lambda path: pickle.dumps({"phi0": GOOD, "target": GOOD}),
    "truncated": lambda path: _good(path)[:2000],
    "corrupt": lambda path: _flipped(_good(path)),
    "corrupt compressed": lambda path: _flipped(_good(path, np.savez_compressed)),
    "single array": lambda path: _npy(GOOD, path),
    "not arrays": lambda path: _zipped(path, b"nothing of the kind"),
    "endless": lambda path: _zipped(
        path, HUGE.replace(b"10**14", b"1" + b"0" * 14).ljust(127) + b"\n"
    ),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_file__that_is_malformed_is_refused(tmp_path: Path, damage: str) -> None:
    path = tmp_path / "own.npz"
    path.write_bytes(DAMAGES[damage](path))
    with pytest.raises(InvalidInputError) as caught:
        load_tasks(path, PAPER)
    what = "pickled objects are never read" if damage == "pickle" else "expected an .npz file"
    assert re.search(rf"own\.npz'.*{re.escape(what)}", str(caught.value))
    assert "\n" not in str(caught.value)


def test_file__is_never_unpickled(tmp_path: Path) -> None:
    trace, bomb = tmp_path / "trace", PickleBomb(tmp_path / "trace")
    bare, inside = tmp_path / "bare.npz", tmp_path / "inside.npz"
    bare.write_bytes(pickle.dumps(bomb))
    np.savez(inside, phi0=np.array([bomb], dtype=object), target=GOOD)
    for path in (bare, inside):
        with pytest.raises(InvalidInputError, match="pickled objects are never read"):
            load_tasks(path, PAPER)
    assert not trace.exists()
    pickle.loads(bare.read_bytes())
    assert trace.exists()  # it would have gone off


def test_file__that_does_not_exist_is_named(tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError, match=r"nothing\.npz.*a file that exists"):
        load_tasks(tmp_path / "nothing.npz", PAPER)
    (tmp_path / "folder.npz").mkdir()
    with pytest.raises(InvalidInputError, match=r"folder\.npz"):
        load_tasks(tmp_path / "folder.npz", PAPER)


@pytest.mark.parametrize("numbers", ["0", "0:5", "", "-3", "3:x", "3:-1", "1e3", "3:", "3.0"])
def test_random_suite__refuses_what_is_no_number(numbers: str) -> None:
    name = f"random:{numbers}"
    with pytest.raises(InvalidInputError, match=rf"^tasks = '{name}': .*N at least 1") as caught:
        load_tasks(name, PAPER)
    assert caught.value.value == name


@pytest.mark.parametrize(
    ("name", "near"), [("paper-50", "paper-500"), ("paper500", "paper-500"), ("sim1", "sim-1")]
)
def test_unknown_suite__gets_a_suggestion(name: str, near: str) -> None:
    with pytest.raises(UnknownNameError, match=rf"task suite '{name}'.*did you mean '{near}'"):
        load_tasks(name, PAPER)


@pytest.mark.parametrize("name", ["", "tasks.csv", "everything"])
def test_unknown_suite__lists_those_that_exist(name: str) -> None:
    with pytest.raises(UnknownNameError, match=r"known: FILE\.npz, paper-500, random:N"):
        load_tasks(name, PAPER)


@pytest.mark.parametrize("task", [-1, 3, 1.5, "0", True, None])
def test_task_that_is_not_there__is_refused(task: Any) -> None:
    with pytest.raises(InvalidInputError, match=r"^task = .*: expected a row from 0 to 2$"):
        random_suite(3, 1, PAPER).initial(task, PAPER)
