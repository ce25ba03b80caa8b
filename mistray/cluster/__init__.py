"""Distribution of traces to the workers of a dask cluster: `mistray.distribute`."""

from mistray.cluster.client import distribute

__all__ = ["distribute"]


def __dir__() -> list[str]:
    return sorted(__all__)
