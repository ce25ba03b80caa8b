"""Analyses of what the ledger says: ghosts, point source transmittance, objects, thermal emission, whole studies."""

from typing import TYPE_CHECKING

from mistray._lazy import lazy_package

if TYPE_CHECKING:
    from mistray.analyses.image.result import FieldImage, ImageQuality, LineImage, PointSpread
    from mistray.analyses.image.run import image_quality
    from mistray.analyses.study.run import Study, study
    from mistray.analyses.thermal.result import ThermalReport
    from mistray.analyses.thermal.run import thermal
    from mistray.analyses.transfer.result import FieldTransfer, Transfer
    from mistray.analyses.transfer.run import transfer
    from mistray.analyses.transfer.surface import SurfaceTransfer, transfer_of_bsdf, transfer_of_spectrum
    from mistray.analysis.critical_rays import critical_rays
    from mistray.analysis.estimate import Estimate
    from mistray.analysis.field_summary import FieldSummary
    from mistray.analysis.ghosts import GhostReport, ghosts
    from mistray.analysis.irradiance import MapStatistics, log10_image, mirror_asymmetry, statistics
    from mistray.analysis.objects.search import Objects, objects
    from mistray.analysis.objects.sources import DiskSource
    from mistray.analysis.path_analysis import path_analysis
    from mistray.analysis.pst.first_level import FirstLevel, first_level
    from mistray.analysis.pst.result import Pst
    from mistray.analysis.pst.transmittance import pst
    from mistray.analysis.ranking import DirectImage

__all__ = lazy_package(
    __name__,
    {
        "critical_rays": ("critical_rays",),
        "estimate": ("Estimate",),
        "field_summary": ("FieldSummary",),
        "ghosts": ("GhostReport", "ghosts"),
        "mistray.analyses.image.run": ("image_quality",),
        "mistray.analyses.image.result": ("FieldImage", "ImageQuality", "LineImage", "PointSpread"),
        "irradiance": ("MapStatistics", "log10_image", "mirror_asymmetry", "statistics"),
        "objects.search": ("Objects", "objects"),
        "objects.sources": ("DiskSource",),
        "path_analysis": ("path_analysis",),
        "pst.first_level": ("FirstLevel", "first_level"),
        "pst.result": ("Pst",),
        "pst.transmittance": ("pst",),
        "ranking": ("DirectImage",),
        "mistray.analyses.study.run": ("Study", "study"),
        "mistray.analyses.thermal.result": ("ThermalReport",),
        "mistray.analyses.thermal.run": ("thermal",),
        "mistray.analyses.transfer.result": ("FieldTransfer", "Transfer"),
        "mistray.analyses.transfer.surface": ("SurfaceTransfer", "transfer_of_bsdf", "transfer_of_spectrum"),
        "mistray.analyses.transfer.run": ("transfer",),
    },
)
