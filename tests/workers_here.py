"""Workers without other processes: tasks are packed and unpacked as on their way, parts come in any order."""

from __future__ import annotations

import contextlib
import pickle
from collections.abc import Iterator
from typing import Any

import numpy as np

from mistray.cluster.travel import Parcel, Unpacked
from mistray.errors import UnfinishedError


class Here:
    """
    Workers of this process.

    Parameters
    ----------
    workers : int
        That they say they are.
    last : int, optional
        Parts after which they are gone.

    Attributes
    ----------
    parts : list
        That have been done.
    """

    def __init__(self, workers: int = 4, last: int | None = None) -> None:
        self.workers, self.last = workers, last
        self.parts: list[Any] = []
        self.unpacked = Unpacked()

    def count(self) -> int:
        return self.workers

    @contextlib.contextmanager
    def job(self, task: Any) -> Iterator[_Job]:
        parcel = Parcel.of(task)
        yield _Job(self, parcel)


class _Job:
    def __init__(self, home: Here, parcel: Parcel) -> None:
        self.home, self.parcel = home, parcel
        self.waiting: list[Any] = []

    def submit(self, part: Any) -> None:
        assert part not in self.waiting
        self.waiting.append(part)

    def result(self, part: Any) -> Any:
        self.waiting.remove(part)
        if self.home.last is not None and len(self.home.parts) >= self.home.last:
            raise UnfinishedError("the workers are gone; start others")
        self.home.parts.append(part)
        task, made = self.home.unpacked.task(self.parcel.task, self.parcel.digest, self.parcel.scenes)
        return pickle.loads(pickle.dumps(task.do(made, pickle.loads(pickle.dumps(part)))))

    def results(self) -> Iterator[tuple[Any, Any]]:
        random = np.random.default_rng(7)
        while self.waiting:
            part = self.waiting[int(random.integers(len(self.waiting)))]
            yield part, self.result(part)
