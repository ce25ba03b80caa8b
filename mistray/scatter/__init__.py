"""Scatter of surfaces: BSDF models that are sums of lobes, in float64 on the host."""

from mistray.scatter.lobe import Lobe, LobeModel, Placement, RatioTable

Scatter = LobeModel  # its name before version 0.3

__all__ = ["Lobe", "LobeModel", "Placement", "RatioTable", "Scatter"]


def __dir__() -> list[str]:
    return sorted(__all__)
