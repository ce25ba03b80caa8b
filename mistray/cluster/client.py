"""Client side of `mistray.distribute`: parts of traces are sent to the workers of a dask cluster."""

from __future__ import annotations

import contextlib
import logging
import queue
import time
import uuid
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

from mistray._variant import ensure_variant
from mistray.cluster.worker import bring, do_part, host_of
from mistray.errors import MistrayError, UnfinishedError
from mistray.execute.workers import working_with
from mistray.files.packages import package

if TYPE_CHECKING:
    from distributed import Client, Future

    from mistray.cluster.travel import Parcel

PATIENCE_S = 30.0  # without any worker
LOOK_S = 1.0  # between two looks at the cluster while nothing comes
CLOSING_S = 2.0
SCENES_KEPT = 4  # at the scheduler


@contextlib.contextmanager
def distribute(client: Client | str, patience_s: float = PATIENCE_S) -> Iterator[None]:
    """
    Trace on the workers of a dask cluster within a block: ``with mistray.distribute(client):``.

    Within the block `mistray.trace`, `mistray.ghosts`, `mistray.pst`, `mistray.study`, `mistray.sweep` and the Monte
    Carlo of `mistray.sensitivity` send parts of their work to the workers and merge the results. docs/distributed.md
    lists the work that is split. The numbers equal those of one process, apart from the rounding of sums, for any
    number of workers, and even if workers die.

    Parameters
    ----------
    client : distributed.Client or str
        Client, or address of a scheduler such as ``"tcp://host:8786"``. Its workers need the same versions of mistray,
        Mitsuba, Dr.Jit and NumPy, and one thread each (``dask worker --nthreads 1``).
    patience_s : float
        Time without any worker after which the cluster is given up, s.

    Raises
    ------
    MistrayError
        If ``distributed`` is not installed, the client is asynchronous, or there is no scheduler or no worker. Within
        the block, if a worker has other versions or several threads, or a part of the work fails.
    UnfinishedError
        Within the block, if the scheduler or all workers are lost; finished work is in ``partial``.

    Examples
    --------
    >>> from distributed import LocalCluster  # in a script: after if __name__ == "__main__"
    >>> with LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster:
    ...     with mistray.distribute(cluster.get_client()):
    ...         t = mistray.trace(mistray.load("lens_and_window"), rays=10_000)
    >>> t.rays_traced
    10000
    """
    Client = package("distribute needs dask.distributed", "distributed", "distributed").Client
    ensure_variant()
    if not isinstance(client, Client | str):
        raise MistrayError(f"distribute got {type(client).__name__}; give a distributed.Client or tcp://host:port")
    if not isinstance(client, str) and client.asynchronous:
        raise MistrayError("distribute got an asynchronous client; give one without asynchronous=True")
    with contextlib.ExitStack() as stack:
        if isinstance(client, str):
            stack.enter_context(_quiet())
            cluster = Cluster(_connect(client, patience_s), client, patience_s)
            stack.callback(_close, cluster.client)
        else:
            cluster = Cluster(client, client.scheduler.address if client.scheduler else "none", patience_s)
        cluster.wait()
        stack.enter_context(working_with(cluster))
        yield


def _connect(address: str, patience_s: float) -> Client:
    from distributed import Client

    client = object.__new__(Client)  # known here even if it cannot be made, so that it is closed in any case
    try:
        Client.__init__(client, address, timeout=patience_s, set_as_default=False)
        return client
    except Exception as error:  # of the address, of the network or of dask's own settings: whatever it meets first
        _close(client)
        what = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise MistrayError(f"scheduler {address}: no answer ({what}); start it, or check the address") from None


def _close(client: Client) -> None:
    """
    Close a client permanently.

    An open client closes itself at garbage collection. If this happens while the next client starts, it waits for ever:
    both need the same lock of `distributed.utils.LoopRunner`.
    """
    with contextlib.suppress(Exception):  # it is gone, or will be with the process
        client.close(timeout=CLOSING_S)
    client.status = "closed"


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Silence the logs of the packages distributed and tornado within a block; exceptions are raised all the same."""
    names = [name for name in logging.root.manager.loggerDict if name.partition(".")[0] in ("distributed", "tornado")]
    loggers = [logging.getLogger(name) for name in names]
    before = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for logger, level in zip(loggers, before, strict=True):
            logger.setLevel(level)


class Cluster:
    """
    Connection to the workers of a dask cluster, for `mistray.execute.workers`.

    Parameters
    ----------
    client : distributed.Client
        Client of the cluster.
    address : str
        Address of the scheduler, for messages.
    patience_s : float
        Time without any worker after which the cluster is given up, s.
    """

    def __init__(self, client: Client, address: str, patience_s: float) -> None:
        self.client, self.address, self.patience_s = client, address, patience_s
        self._scenes: dict[str, Future] = {}

    def hosts(self) -> Counter[str]:
        """Return the number of workers on each host; raise `UnfinishedError` if the scheduler is gone."""
        if self.client.status != "running":
            raise self.gone()
        try:
            workers = self.client.scheduler_info(n_workers=-1)["workers"]
        except Exception as error:  # whatever a lost connection makes of it
            raise self.gone() from error
        return Counter(map(host_of, workers))

    def count(self) -> int:
        """Return the number of workers, at least 1; raise `UnfinishedError` if the scheduler is gone."""
        return max(self.hosts().total(), 1)

    def wait(self) -> None:
        """
        Wait for the first worker.

        Raise `MistrayError` after `patience_s` seconds without any, and `UnfinishedError` if the scheduler is lost.
        """
        started = time.monotonic()
        while not self.hosts():
            if time.monotonic() - started > self.patience_s:
                raise MistrayError(
                    f"scheduler {self.address} has no workers; start some: dask worker {self.address} --nthreads 1"
                )
            time.sleep(LOOK_S / 10)

    def gone(self) -> UnfinishedError:
        """Return the error for a lost connection to the scheduler."""
        return UnfinishedError(
            f"the connection to the scheduler {self.address} is lost; start it and its workers again"
        )

    def deserted(self) -> UnfinishedError:
        """Return the error for a scheduler without workers."""
        return UnfinishedError(f"no worker is left at the scheduler {self.address}; start new ones")

    @contextlib.contextmanager
    def job(self, task: Any) -> Iterator[DaskJob]:
        """
        Start a job for a task, and close it at the end of the block; see `mistray.execute.workers.Workers`.

        Raise `MistrayError` if the task cannot be packed, and `UnfinishedError` if the scheduler is lost.
        """
        from mistray.cluster.travel import Parcel

        parcel = Parcel.of(task)
        job = DaskJob(self, parcel, self.sending(lambda: self._bring(parcel)))
        try:
            yield job
        finally:
            job.close()

    def sending(self, action: Callable[[], Any]) -> Any:
        """
        Return the result of an action that needs the scheduler.

        Raise `UnfinishedError` if the scheduler is lost; other errors of the action pass.
        """
        if self.client.status != "running":
            raise self.gone()
        try:
            with warnings.catch_warnings():  # that what is sent is large
                warnings.simplefilter("ignore", UserWarning)
                return action()
        except Exception as error:
            if self.client.status == "running":
                raise
            raise self.gone() from error

    def _bring(self, parcel: Parcel) -> list[Future]:
        """
        Send a task and its scenes to the scheduler, where scenes stay.

        Return the futures, that of the task first.
        """
        for name, content in parcel.scenes.items():
            known = self._scenes.pop(name, None)
            if known is None or known.status not in ("pending", "finished"):
                known = self.client.submit(bring, content, key=f"mistray-scene-{name}-{uuid.uuid4().hex}")
            self._scenes[name] = known
        while len(self._scenes) > max(SCENES_KEPT, len(parcel.scenes)):
            del self._scenes[next(iter(self._scenes))]
        task = self.client.submit(bring, parcel.task, key=f"mistray-task-{parcel.digest}-{uuid.uuid4().hex}")
        return [task, *(self._scenes[name] for name in parcel.scenes)]


class DaskJob:
    """
    Job: parts of a task that workers of a cluster compute, see `mistray.execute.workers.Job`.

    Parameters
    ----------
    cluster : Cluster
        Cluster that does the work.
    parcel : Parcel
        Packed task.
    futures : list of Future
        Futures of the bytes of the task and of its scenes.
    """

    def __init__(self, cluster: Cluster, parcel: Parcel, futures: list[Future]) -> None:
        from mistray.cluster.travel import surroundings

        self._cluster, self._parcel, self._futures = cluster, parcel, futures
        self._surroundings, self._sharing = surroundings(), dict(cluster.hosts())
        self._name = f"mistray-part-{uuid.uuid4().hex}"
        self._number = 0
        self._waiting: dict[Any, Future] = {}
        self._done: dict[Any, None] = {}
        self._news: queue.SimpleQueue[Any] = queue.SimpleQueue()

    def submit(self, part: Any) -> None:
        """Send one more part of the task to the workers; raise `UnfinishedError` if the scheduler is lost."""
        task, *scenes = self._futures
        self._number += 1
        future = self._cluster.sending(
            lambda: self._cluster.client.submit(
                do_part,
                task,
                scenes,
                list(self._parcel.scenes),
                self._parcel.digest,
                part,
                self._surroundings,
                self._sharing,
                key=f"{self._name}-{self._number}",
            )
        )
        self._waiting[part] = future
        future.add_done_callback(lambda _: self._news.put(part))

    def result(self, part: Any) -> Any:
        """
        Wait for a part and return its result.

        Raise `MistrayError` if the part failed, and `UnfinishedError` if the scheduler or all workers are lost.
        """
        while part not in self._done:
            self._done[self._next()] = None
        del self._done[part]
        return self._take(part)

    def results(self) -> Iterator[tuple[Any, Any]]:
        """
        Yield all parts with their results, in the order in which they are completed.

        Errors are those of `result`.
        """
        while self._waiting:
            part = next(iter(self._done), None)
            if part is None:
                part = self._next()
            self._done.pop(part, None)
            yield part, self._take(part)

    def _next(self) -> Any:
        """
        Wait until a part has succeeded or failed, and return the part.

        Raise `UnfinishedError` if there is no worker for `patience_s` seconds, or if the scheduler is lost.
        """
        alone_since: float | None = None
        while True:
            try:
                return self._news.get(timeout=LOOK_S)
            except queue.Empty:
                pass
            if self._cluster.hosts():
                alone_since = None
                continue
            alone_since = time.monotonic() if alone_since is None else alone_since
            if time.monotonic() - alone_since > self._cluster.patience_s:
                raise self._cluster.deserted()

    def _take(self, part: Any) -> Any:
        from distributed import KilledWorker

        future, limit_s = self._waiting.pop(part), self._cluster.patience_s
        try:
            while True:
                try:
                    return future.result(timeout=limit_s)
                except TimeoutError:  # its worker is lost, so that another one repeats the part; or it is large
                    if future.status == "error":  # of the part itself
                        raise
                    if not self._cluster.hosts():
                        raise self._cluster.deserted() from None
                    limit_s *= 2
        except MistrayError:
            raise
        except KilledWorker:
            raise MistrayError(
                f"part {part} of the work ended several workers, one after the other: they may have too little memory; "
                "ask for fewer paths or pixels, or give them more"
            ) from None
        except Exception as error:
            if future.status != "error":  # no part has failed: the connection is lost
                raise self._cluster.gone() from error
            text = " ".join(str(error).split())
            raise MistrayError(f"a worker failed: {type(error).__name__}: {text}; look at its log") from error
        finally:
            future.release()

    def close(self) -> None:
        """Cancel all unfinished parts, unless the scheduler is lost, and forget them."""
        rest = list(self._waiting.values())
        if rest and self._cluster.client.status == "running":
            with contextlib.suppress(Exception):  # nobody needs them any more
                self._cluster.client.cancel(rest)
        self._waiting.clear()
        self._futures.clear()
