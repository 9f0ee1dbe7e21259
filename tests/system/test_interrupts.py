"""Ctrl-C and SIGTERM at any moment of a command: one line at most, no traceback, exit code 130."""

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from snake_env.system import interrupts
from tests.support import ROOT

# Sends the process a signal at a moment that the environment names: as a module is imported, or at
# the interpreter's end.
_SITE = """
import atexit, importlib.abc, os, sys
moment, number = os.environ.pop("MOMENT", ""), int(os.environ["NUMBER"])  # not in children

def send():
    os.kill(os.getpid(), number)

class Finder(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name == moment:
            sys.meta_path.remove(self)
            send()

if moment == "atexit":
    atexit.register(send)  # the first to be registered is the last to be called
elif moment:
    sys.meta_path.insert(0, Finder())
"""
EVALUATE = ("evaluate", "analytic", "--tasks", "random:4:3", "--no-latency")
TRAIN = ("train", "value", "--set", "n_joints=5", "--generations", "1", "--episodes", "8")
GIF = ("snake_env", "gif", "--out", "{tmp}/snake.gif")
MOMENTS = [
    (EVALUATE, "gymnasium"),
    (EVALUATE, "llvmlite"),
    (EVALUATE, "snake_env.policies.registry"),
    (EVALUATE, "evaluate.__main__"),
    (EVALUATE, "rich"),
    (EVALUATE, "joblib"),
    (EVALUATE, "evaluate.comparison"),
    (TRAIN, "gymnasium"),
    (TRAIN, "train.config"),
    (TRAIN, "torch"),
    (TRAIN, "train.value"),
    (("train", "--help"), "yaml"),
    (("train", "ppo", "--help"), "stable_baselines3"),
    (GIF, "gymnasium.envs"),
    (GIF, "snake_env.__main__"),
    (GIF, "PIL"),
    (("snake_env", "check"), "snake_env.state"),
]
SIGNALS = (signal.SIGINT, signal.SIGTERM)


def _run(words: tuple[str, ...], moment: str, number: int, tmp: Path) -> tuple[int, str, str]:
    (tmp / "sitecustomize.py").write_text(_SITE)
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join([str(tmp), str(ROOT)]),
        "MOMENT": moment,
        "NUMBER": str(number),
    }
    done = subprocess.run(
        [sys.executable, "-m", *(word.replace("{tmp}", str(tmp)) for word in words)],
        cwd=ROOT, capture_output=True, text=True, env=environment,
        stdin=subprocess.DEVNULL,
    )  # fmt: skip
    return done.returncode, done.stdout, done.stderr


@pytest.mark.parametrize(
    ("words", "moment", "number"),
    [(*MOMENTS[k], SIGNALS[k % 2]) for k in range(len(MOMENTS))]
    + [
        (EVALUATE, "rich", signal.SIGTERM),
        (TRAIN, "torch", signal.SIGINT),
        (GIF, "PIL", signal.SIGINT),
    ],
)
def test_interrupt__during_imports_and_set_up(
    words: tuple[str, ...], moment: str, number: int, tmp_path: Path
) -> None:
    code, _, stderr = _run(words, moment, number, tmp_path)
    if words[-1] == "--help" and code == 0:
        pytest.fail(f"{moment} is not imported: the test does not test what it should")
    assert "Traceback" not in stderr
    assert len(stderr.strip().splitlines()) <= 1
    assert code == 130


def test_packages_of_others__keep_their_interrupts(tmp_path: Path) -> None:
    """Somebody's own package may be called "train" and import the library."""
    package = tmp_path / "train"
    package.mkdir()
    (package / "__init__.py").write_text(
        "import os, signal\nimport snake_env\n"
        "try:\n    os.kill(os.getpid(), signal.SIGINT)\n"
        "except KeyboardInterrupt:\n    print('saved', flush=True)\n"
    )
    (package / "__main__.py").write_text("print('goes on')\n")
    done = subprocess.run(
        [sys.executable, "-m", "train"], cwd=tmp_path, capture_output=True, text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert (done.returncode, done.stdout, done.stderr) == (0, "saved\ngoes on\n", "")


@pytest.mark.parametrize("words", [EVALUATE, ("snake_env", "gif", "--out", "{tmp}/a.gif")])
def test_interrupt__when_all_is_done_changes_nothing(
    words: tuple[str, ...], tmp_path: Path
) -> None:
    code, stdout, stderr = _run(words, "atexit", signal.SIGINT, tmp_path)
    assert (code, stderr) == (0, "")
    assert stdout


def test_guarded__runs_what_is_wanted_and_restores_the_handlers() -> None:
    before = [signal.getsignal(number) for number in SIGNALS]
    for number in SIGNALS:
        assert interrupts.guarded(lambda n=number: _after_signal(n), lambda: 130) == 130
    assert interrupts.guarded(lambda: 7, lambda: 130) == 7
    with pytest.raises(ZeroDivisionError):
        interrupts.guarded(lambda: 1 // 0, lambda: 130)
    assert [signal.getsignal(number) for number in SIGNALS] == before


def _after_signal(number: int) -> int:
    os.kill(os.getpid(), number)
    time.sleep(0.01)
    return 0


def test_guarded__puts_things_in_order_undisturbed() -> None:
    steps = []

    def in_order() -> int:
        for step in range(3):
            os.kill(os.getpid(), signal.SIGINT)
            steps.append(step)
        return 130

    assert interrupts.guarded(lambda: _after_signal(signal.SIGINT), in_order) == 130
    assert steps == [0, 1, 2]


def test_guarded__runs_in_other_threads_too() -> None:
    found: list[int] = []
    thread = threading.Thread(
        target=lambda: found.append(interrupts.guarded(lambda: 5, lambda: 130))
    )
    thread.start()
    thread.join()
    assert found == [5]


def test_children__never_see_it() -> None:
    with interrupts.children_ignore():
        child = subprocess.Popen(
            [sys.executable, "-c", "import sys; print('up', flush=True); sys.stdin.read()"],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        )  # fmt: skip
    assert child.stdout is not None
    child.stdout.readline()
    child.send_signal(signal.SIGINT)
    child.communicate()
    assert child.returncode == 0
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, [])
