"""Engines: every shard has one result, whatever runs it and whoever dies meanwhile."""

import contextlib
import functools
import importlib.util
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
import threadpoolctl

from evaluate.__main__ import main
from harness.engine import Engine, WorkerLostError
from snake_env.errors import InvalidInputError, UnknownNameError
from tests.support import HANGS_S
from tests.support.commands import Command, names, wait_until

EVALUATE = Command(main)
SHARDS = list(range(30))
TASKS = ("analytic", "random", "--tasks", "random:150:1", "--no-latency", "--no-pictures")

needs_ray = pytest.mark.skipif(importlib.util.find_spec("ray") is None, reason="needs Ray")


def _square(shard: int) -> tuple[int, int]:
    return shard, shard**2


def _process(shard: int) -> int:
    time.sleep(0.05)
    return os.getpid()


def _blas_threads(shard: int) -> list[int]:
    assert np.linalg.inv(np.eye(3)).shape == (3, 3)
    pools = threadpoolctl.threadpool_info()
    return [pool["num_threads"] for pool in pools if pool["user_api"] == "blas"]


def _die_once(mark: Path, shard: int) -> tuple[int, int]:
    """The square, but the first process that comes to shard 7 dies."""
    if shard == 7:
        with contextlib.suppress(FileExistsError):
            mark.touch(exist_ok=False)
            os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(0.02)
    return _square(shard)


def _die(shard: int) -> int:
    if shard == 7:
        os.kill(os.getpid(), signal.SIGKILL)
    return shard


def _fail(shard: int) -> int:
    return 1 // (shard - 3)


def _alive(pid: int) -> bool:
    return psutil.pid_exists(pid) and psutil.Process(pid).status() != psutil.STATUS_ZOMBIE


@pytest.fixture(scope="module")
def _ray() -> Iterator[None]:
    """A cluster that this process starts when an engine first needs it."""
    ray = pytest.importorskip("ray")
    handler = signal.getsignal(signal.SIGTERM)
    yield
    ray.shutdown()
    signal.signal(signal.SIGTERM, handler)


@pytest.fixture(params=["local", "ray"])
def engine(request: pytest.FixtureRequest) -> Engine:
    """Two workers."""
    if request.param == "ray":
        request.getfixturevalue("_ray")
    return Engine(engine=request.param, workers=2)


def test_map__gives_each_result_once(engine: Engine) -> None:
    engine.check()
    assert sorted(engine.map(_square, SHARDS)) == [(k, k**2) for k in SHARDS]
    assert list(engine.map(_square, [])) == []


def test_map__uses_the_workers(engine: Engine) -> None:
    pids = set(engine.map(_process, SHARDS))
    assert len(pids) == 2
    assert os.getpid() not in pids


def test_shards__are_taken_as_workers_become_free() -> None:
    taken = []

    def shards() -> Iterator[int]:
        for shard in range(1000):
            taken.append(shard)
            yield shard

    results = Engine(workers=2).map(_process, shards())
    next(results)
    assert len(taken) < 100
    results.close()


def test_shards__that_fail_to_be_made_are_an_error() -> None:
    def shards() -> Iterator[int]:
        yield from range(10)
        raise InvalidInputError("task", 10, "a task")

    for workers in (1, 2):
        with pytest.raises(InvalidInputError, match="task = 10"):
            list(Engine(workers=workers).map(_square, shards()))


def test_one_worker__is_the_process_itself() -> None:
    for name in ("local", "ray"):
        own = Engine(engine=name, workers=1)  # type: ignore[arg-type]
        assert set(own.map(_process, SHARDS[:3])) == {os.getpid()}
        assert list(own.map(_square, SHARDS)) == [(k, k**2) for k in SHARDS]


def test_blas__runs_on_one_thread(engine: Engine) -> None:
    before = _blas_threads(0)
    for threads in (
        *engine.map(_blas_threads, range(4)),
        *Engine(workers=1).map(_blas_threads, range(2)),
    ):
        assert threads
        assert set(threads) == {1}
    assert _blas_threads(0) == before


def test_killed_worker__loses_and_doubles_nothing(
    engine: Engine, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    results = list(engine.map(functools.partial(_die_once, tmp_path / "mark"), SHARDS))
    assert (tmp_path / "mark").exists()
    assert sorted(results) == [(k, k**2) for k in SHARDS]
    assert "a worker died: " in capfd.readouterr().err


def test_shard_that_kills_its_workers__ends_the_work(engine: Engine) -> None:
    results = []
    with pytest.raises(WorkerLostError, match="workers died 6 times"):
        results.extend(engine.map(_die, SHARDS))  # extend keeps what came before the error
    assert 7 not in results
    assert len(set(results)) == len(results)


def test_error_in_the_work__comes_through(engine: Engine) -> None:
    with pytest.raises(ZeroDivisionError):
        list(engine.map(_fail, SHARDS))


def test_unwanted_results__leave_no_workers(engine: Engine) -> None:
    results = engine.map(_process, range(1000))
    pid = next(results)
    began = time.monotonic()
    results.close()
    while _alive(pid):
        assert time.monotonic() - began < HANGS_S
        time.sleep(0.05)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"workers": 0}, "workers = 0: expected a positive number, or -1 for all cores"),
        ({"workers": -2}, "workers = -2: expected a positive number, or -1 for all cores"),
        ({"address": "auto"}, "address = 'auto': expected none without --engine ray"),
    ],
)
def test_bad_options__are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidInputError) as refusal:
        Engine(**options).check()
    assert str(refusal.value) == message


def test_unknown_engine__is_refused() -> None:
    with pytest.raises(UnknownNameError, match="unknown engine 'rai': did you mean 'ray'"):
        Engine(engine="rai").check()  # type: ignore[arg-type]


@needs_ray
@pytest.mark.parametrize("address", ["nonsense", "ray://127.0.0.1:10001", "local", "host:port"])
def test_address_that_is_none__is_refused_at_once(address: str) -> None:
    with pytest.raises(InvalidInputError, match="expected HOST:PORT of a Ray cluster, or auto"):
        Engine(engine="ray", address=address).check()


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


@needs_ray
def test_unreachable_cluster__is_refused_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "summary.json").write_text("{}")
    arguments = (*TASKS, "--out", tmp_path, "--overwrite", "--engine", "ray")
    done = EVALUATE.process(*arguments, "--address", f"127.0.0.1:{_free_port()}", code=2)
    assert (done.stdout, done.stderr.count("\n")) == ("", 1)
    assert done.stderr.startswith("error: address = '127.0.0.1:")
    assert "expected a Ray cluster that answers within 15 s" in done.stderr
    assert names(tmp_path) == {"summary.json"}


@pytest.fixture(scope="module")
def cluster() -> Iterator[dict[str, str]]:
    """A Ray cluster of two CPUs on this machine; the environment variables that open it."""
    pytest.importorskip("ray")
    port = _free_port()
    variables = {
        "RAY_ADDRESS": f"127.0.0.1:{port}",
        "RAY_AUTH_MODE": "token",
        "RAY_AUTH_TOKEN": uuid.uuid4().hex,
        "RAY_USAGE_STATS_ENABLED": "0",
    }
    environment = {key: value for key, value in variables.items() if key != "RAY_ADDRESS"}
    with tempfile.TemporaryDirectory(prefix="ray", ignore_cleanup_errors=True) as folder:
        head = subprocess.Popen(
            [
                *(sys.executable, "-m", "ray.scripts.scripts", "start", "--head", "--block"),
                *(f"--port={port}", "--num-cpus=2", "--include-dashboard=false"),
                f"--temp-dir={folder}",  # a short name: it ends up in those of sockets
            ],
            env=os.environ | environment, stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        try:
            wait_until((Path(folder) / "ray_current_cluster").exists, head)
            yield variables
        finally:
            processes = [head, *psutil.Process(head.pid).children(recursive=True)]
            head.terminate()
            with contextlib.suppress(subprocess.TimeoutExpired):
                head.wait(20)
            for process in processes:
                with contextlib.suppress(psutil.NoSuchProcess):
                    process.kill()


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What one process gives."""
    out = tmp_path_factory.mktemp("engine") / "local"
    EVALUATE.process(*TASKS, "--out", out, "--workers", 1)
    return out


def _check_equal(out: Path, reference: Path) -> None:
    assert (out / "episodes.csv").read_bytes() == (reference / "episodes.csv").read_bytes()
    assert (out / "summary.json").read_bytes() == (reference / "summary.json").read_bytes()
    assert names(out) == {"episodes.csv", "summary.json"}


def _workers_of_a_cluster(token: str) -> list[psutil.Process]:
    found = []
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error):
            name = " ".join(process.cmdline())
            if "PoolActor" in name and process.environ().get("RAY_AUTH_TOKEN") == token:
                found.append(process)
    return found


def test_cluster__gives_the_same_bytes_though_a_worker_is_killed(
    cluster: dict[str, str], reference: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    arguments = (*TASKS, "--out", out, "--engine", "ray", "--address", "auto")
    process = EVALUATE.start(*arguments, **cluster)
    partial = out / "episodes.partial.jsonl"
    wait_until(lambda: partial.exists() and partial.read_bytes().count(b"\n") >= 30, process)
    workers = _workers_of_a_cluster(cluster["RAY_AUTH_TOKEN"])
    assert len(workers) == 2
    workers[0].kill()
    _, stderr = process.communicate(timeout=HANGS_S)
    assert process.returncode == 0, stderr
    assert "a worker died: " in stderr
    _check_equal(out, reference)


def test_cluster__refuses_more_workers_than_it_has_cpus(cluster: dict[str, str]) -> None:
    arguments = (*TASKS, "--engine", "ray", "--address", "auto", "--workers", 3)
    done = EVALUATE.process(*arguments, code=2, **cluster)
    assert done.stderr == "error: workers = 3: expected at most 2, the CPUs of the Ray cluster\n"
