"""Watches a learner: progress, figures of its episodes, and Ctrl-C."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback

from harness.progress import Advance


class Watch(BaseCallback):
    """Shows progress and keeps the figures of the segment's episodes."""

    def __init__(self, advance: Advance, name: str) -> None:
        super().__init__()
        self._advance, self._name = advance, name
        self._episodes: list[dict[str, Any]] = []

    def _on_step(self) -> bool:
        infos = self.locals["infos"]
        self._episodes += [info for info in infos if "episode_summary" in info]
        self._advance(self._name, len(infos))
        return True

    def figures(self) -> dict[str, float]:
        """Return, success rate and mean time of the episodes that ended, exploration included."""
        solved = [e["episode_summary"]["time_s"] for e in self._episodes if e["is_success"]]
        count = max(1, len(self._episodes))
        return {
            "train_return": round(sum(e["episode"]["r"] for e in self._episodes) / count, 4),
            "train_success": round(len(solved) / count, 4),
            "train_time_s": round(float(np.mean(solved)) if solved else float("nan"), 3),
        }


@contextmanager
def stopping() -> Iterator[threading.Event]:
    """An event that Ctrl-C and SIGTERM set; the segment is finished then. A second one interrupts."""
    stop = threading.Event()

    def handle(number: int, frame: Any) -> None:
        if stop.is_set():
            raise KeyboardInterrupt
        stop.set()
        print("\nstopping after this segment (press Ctrl-C again to stop now)", flush=True)

    if threading.current_thread() is not threading.main_thread():
        yield stop
        return
    before = {number: signal.signal(number, handle) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
