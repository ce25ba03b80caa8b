"""Traces by the workers of a dask cluster: `mistray.distribute`."""

from mistray.cluster.client import distribute

__all__ = ["distribute"]
