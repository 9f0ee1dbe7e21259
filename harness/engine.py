"""Runs shards of work on processes of this machine, or on a Ray cluster."""

from __future__ import annotations

import importlib.util
import itertools
import logging
import os
import re
import signal
import subprocess
import sys
import threading
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import resource_tracker
from typing import Annotated, Any, Generic, Literal, TypeVar

import joblib
import tyro
from joblib.externals.loky.backend import resource_tracker as loky_tracker
from joblib.externals.loky.process_executor import TerminatedWorkerError
from threadpoolctl import threadpool_limits

from snake_env.errors import (
    InvalidInputError,
    MissingDependencyError,
    SnakeEnvError,
    UnknownNameError,
)
from snake_env.system import interrupts
from snake_env.system.exit_code import complain

# Workers that have been idle end by themselves, and others take their place: nobody needs to know.
warnings.filterwarnings("ignore", "A worker stopped while some jobs were given")

Shard = TypeVar("Shard")
Result = TypeVar("Result")

_LOSSES = 5  # as often, workers are replaced
_PATIENCE_S = 15.0  # Ray itself tries to reach a cluster for minutes
_PROBE = """
import sys, ray
try:
    ray.init(address=sys.argv[1], log_to_driver=False, logging_level="ERROR")
except Exception as problem:
    print(*str(problem).split())
    sys.exit(1)
print(int(ray.cluster_resources().get("CPU", 0)))
"""


class WorkerLostError(SnakeEnvError):
    """Workers died again and again; the results that came before are good."""


@dataclass(frozen=True)
class Engine:
    """Parallel execution. Results do not depend on it."""

    engine: Literal["local", "ray"] = "local"
    """local: processes on this machine; ray: a Ray cluster."""
    address: Annotated[str | None, tyro.conf.arg(metavar="HOST:PORT")] = None
    """Address of a running Ray cluster; auto: the cluster on this machine. Default: start a local
    one."""
    workers: int = -1
    """Worker processes; -1: one per core; 1: no extra process."""

    def check(self) -> None:
        """Checks whether the options can be used, before there is work to lose.

        Raises:
            SnakeEnvError: An option's value can't be used, Ray is missing, or can't be reached.
        """
        if self.engine not in ("local", "ray"):
            raise UnknownNameError("engine", self.engine, ["local", "ray"])
        if self.workers == 0 or self.workers < -1:
            expected = "a positive number, or -1 for all cores"
            raise InvalidInputError("workers", self.workers, expected)
        if self.engine == "local":
            if self.address is not None:
                raise InvalidInputError("address", self.address, "none without --engine ray")
            return
        if importlib.util.find_spec("ray") is None:
            raise MissingDependencyError("--engine ray needs Ray: pip install snake-mode-env[ray]")
        if self.address is not None:
            self._check_cluster(self.address)

    def _check_cluster(self, address: str) -> None:
        if address != "auto" and not re.fullmatch(r"[^\s/]+:\d{1,5}", address):
            raise InvalidInputError("address", address, "HOST:PORT of a Ray cluster, or auto")
        # in a process that can be killed: ray.init itself tries for minutes
        try:
            probe = subprocess.run(
                [sys.executable, "-c", _PROBE, address],
                stdin=subprocess.DEVNULL,
                capture_output=True,
                timeout=_PATIENCE_S,
            )
            answered, printed, complaints = probe.returncode == 0, probe.stdout, probe.stderr
        except subprocess.TimeoutExpired as late:
            answered, printed, complaints = False, b"", late.stderr or b""
        if not answered:
            raise InvalidInputError("address", address, _expected_cluster(printed or complaints))
        cpus = int(printed)
        if self.workers > cpus:
            expected = f"at most {cpus}, the CPUs of the Ray cluster"
            raise InvalidInputError("workers", self.workers, expected)

    def map(
        self, work: Callable[[Shard], Result], shards: Iterable[Shard]
    ) -> Generator[Result, None, None]:
        """Does the work on every shard.

        Linear algebra runs on one thread in each worker: its sums depend on the number of threads. When
        a worker dies, what is unfinished is begun again on new ones, so every shard has one result.

        Args:
            work: Called with one shard at a time; it and its results can be pickled.
            shards: What can be done in any order and anywhere; taken as workers become free.

        Yields:
            Results, as they come: in any order.

        Raises:
            WorkerLostError: Workers died too often.
        """
        source = iter(shards)
        first = list(itertools.islice(source, 1))
        if not first:
            return
        count = self._count()
        first += itertools.islice(source, count - 1)
        count = min(count, len(first))
        queue = _Queue(itertools.chain(first, source))
        if count == 1:
            for number, shard in queue.take():
                yield _call(work, number, shard)[1]
                queue.finish(number)
            return
        losses = 0
        while not queue.finished:
            parallel = joblib.Parallel(
                count, backend=self._backend(), return_as="generator_unordered", batch_size=1
            )
            calls = (joblib.delayed(_call)(work, *numbered) for numbered in queue.take())
            try:
                _start_trackers()
                with interrupts.children_ignore():
                    begun_calls = parallel(calls)
                with _closing(begun_calls) as results:
                    for number, result in results:
                        queue.finish(number)
                        yield result
            except self._lost() as problem:
                losses += 1
                if losses > _LOSSES:
                    reason = str(problem).split("\n", 1)[0]
                    raise WorkerLostError(f"workers died {losses} times: {reason}") from None
                begun = len(queue.begun)
                complain(f"a worker died: {begun} shards are begun again")

    def _count(self) -> int:
        """How many workers there will be."""
        wanted: int = joblib.cpu_count() if self.workers == -1 else self.workers
        if self.engine == "local" or self.workers == 1:
            return wanted
        import ray

        if not ray.is_initialized():
            self._start_ray(wanted)
        cpus = ray.cluster_resources()["CPU"]  # type: ignore[no-untyped-call]
        return int(cpus) if self.workers == -1 else wanted

    def _start_ray(self, cpus: int) -> None:
        """Connects to the cluster, or starts one with ``cpus`` CPUs, which ends with this process."""
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        import ray

        where: dict[str, Any] = (
            {"address": "local", "num_cpus": cpus, "include_dashboard": False}
            if self.address is None
            else {"address": self.address}
        )
        handler = signal.getsignal(signal.SIGTERM)
        ray.init(**where, log_to_driver=False, logging_level=logging.ERROR)
        if callable(handler) and threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGTERM, handler)  # Ray has put its own there

    def _backend(self) -> Any:
        if self.engine == "local":
            return "loky"
        from ray.util.joblib.ray_backend import RayBackend

        class Backend(RayBackend):
            supports_return_generator = True  # what keeps joblib from it are forked processes

        return Backend(ray_remote_args={"num_cpus": 1})

    def _lost(self) -> tuple[type[Exception], ...]:
        """What is raised when a worker dies."""
        if self.engine == "local":
            return (TerminatedWorkerError,)
        from ray.exceptions import ObjectLostError, OutOfMemoryError, RayActorError

        return (RayActorError, ObjectLostError, OutOfMemoryError)


class _Queue(Generic[Shard]):
    """Shards, numbered and taken one by one, and what has been begun of them.

    joblib takes shards in threads of its own, and a pool that breaks may take some more: what is taken
    counts as begun until its result is there.

    Attributes:
        begun: Shards without a result yet, by number.
    """

    def __init__(self, shards: Iterable[Shard]) -> None:
        self.begun: dict[int, Shard] = {}
        self._source = enumerate(shards)
        self._exhausted = False
        self._lock = threading.Lock()

    def take(self) -> Iterator[tuple[int, Shard]]:
        """Shards that were begun before and have no result, then new ones."""
        with self._lock:
            again = list(self.begun.items())
        yield from again
        while (numbered := self._next()) is not None:
            yield numbered

    def _next(self) -> tuple[int, Shard] | None:
        with self._lock:
            numbered = next(self._source, None)
            if numbered is None:
                self._exhausted = True
            else:
                self.begun[numbered[0]] = numbered[1]
            return numbered

    def finish(self, number: int) -> None:
        """Records a result."""
        with self._lock:
            del self.begun[number]

    @property
    def finished(self) -> bool:
        """Whether every shard has its result."""
        return self._exhausted and not self.begun


def _expected_cluster(complaints: bytes) -> str:
    """What is wrong with the cluster: Ray's first complaint tells."""
    lines = complaints.decode(errors="replace").splitlines()
    reason = re.sub(r"^\[.*?\] (\S+:\d+: )?", "", lines[0]) if lines else "no answer"
    hint = ": set RAY_AUTH_MODE=token?" if "token" in reason else ""
    return f"a Ray cluster that answers within {_PATIENCE_S:.0f} s ({reason}{hint})"


def _start_trackers() -> None:
    """Starts the processes that track resources: they unblock SIGINT here when they are started."""
    if hasattr(signal, "pthread_sigmask"):  # where there are none, there is nothing to unblock
        loky_tracker.ensure_running()
        resource_tracker.ensure_running()


def _call(work: Callable[[Shard], Result], number: int, shard: Shard) -> tuple[int, Result]:
    with threadpool_limits(1, "blas"):
        return number, work(shard)


@contextmanager
def _closing(results: Generator[Result, None, None]) -> Iterator[Iterator[Result]]:
    """Ends the workers when the results are not wanted any more."""
    try:
        yield results
    finally:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # joblib regrets the work that is thrown away
            results.close()
