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
    """Workers of this process: as many as they say, gone after so many parts; the parts that have been done."""

    def __init__(self, workers: int = 4, last: int | None = None) -> None:
        self.workers, self.last = workers, last
        self.parts: list[Any] = []
        self.unpacked = Unpacked()

    def count(self) -> int:
        return self.workers

    @contextlib.contextmanager
    def job(self, task: Any) -> Iterator[_Job]:
        yield _Job(self, Parcel.of(task))


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


def assert_same(a: Any, b: Any, rtol: float = 1e-12) -> None:
    """Two traces with the same numbers but for the rounding of sums of some 1e5 numbers of float64."""
    x, y = a.paths.to_pandas(), b.paths.to_pandas()
    for name in x.columns:
        if x[name].dtype.kind in "fi":
            # Errors of paths whose rays are all alike are differences of sums
            np.testing.assert_allclose(x[name], y[name], rtol=1e-5, atol=1e-12, err_msg=name)
        else:
            assert list(x[name]) == list(y[name])
    np.testing.assert_allclose(x.power_W, y.power_W, rtol=rtol)
    np.testing.assert_allclose(a.irradiance, b.irradiance, rtol=rtol)
    np.testing.assert_allclose(a.irradiance_se, b.irradiance_se, rtol=1e-9)
    np.testing.assert_allclose(a.surfaces.to_pandas().absorbed_W, b.surfaces.to_pandas().absorbed_W, rtol=rtol)
    assert list(a.surfaces.to_pandas().hits) == list(b.surfaces.to_pandas().hits)
    assert abs(a.energy.closure - b.energy.closure) < 1e-12
    assert (a.rays_traced, a.segments, a.settings["rays"]) == (b.rays_traced, b.segments, b.settings["rays"])
