"""What the ledger says: ghosts and irradiance maps."""

from mistray.analysis.estimate import Estimate
from mistray.analysis.ghosts import FieldSummary, GhostReport, ghosts
from mistray.analysis.irradiance import MapStatistics, log10_image, mirror_asymmetry, statistics
from mistray.analysis.ranking import DirectImage

__all__ = [
    "DirectImage",
    "Estimate",
    "FieldSummary",
    "GhostReport",
    "MapStatistics",
    "ghosts",
    "log10_image",
    "mirror_asymmetry",
    "statistics",
]
