"""Scatter of surfaces: models that are sums of lobes, in float64 on the host."""

from mistray.scatter.lobe import Lobe, Placement, RatioTable, Scatter

__all__ = ["Lobe", "Placement", "RatioTable", "Scatter"]


def __dir__() -> list[str]:
    return sorted(__all__)
