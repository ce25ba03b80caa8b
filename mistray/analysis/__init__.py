"""Names of analyses, re-exported: ghosts, point source transmittance, objects, thermal emission, whole studies."""

from typing import TYPE_CHECKING

from mistray._lazy import lazy_package

if TYPE_CHECKING:
    from mistray.analyses.export.critical_rays import critical_rays
    from mistray.analyses.ghosts.field_summary import FieldSummary
    from mistray.analyses.ghosts.path_analysis import path_analysis
    from mistray.analyses.ghosts.result import GhostReport
    from mistray.analyses.ghosts.run import ghosts
    from mistray.analyses.image.result import FieldImage, ImageQuality, LineImage, PointSpread
    from mistray.analyses.image.run import image_quality
    from mistray.analyses.objects.result import Objects
    from mistray.analyses.objects.run import objects
    from mistray.analyses.pst.first_level import FirstLevel, first_level
    from mistray.analyses.pst.result import Pst
    from mistray.analyses.pst.run import pst
    from mistray.analyses.study.result import Study
    from mistray.analyses.study.run import study
    from mistray.analyses.thermal.result import ThermalReport
    from mistray.analyses.thermal.run import thermal
    from mistray.analyses.transfer.result import FieldTransfer, Transfer
    from mistray.analyses.transfer.run import transfer
    from mistray.analyses.transfer.surface import SurfaceTransfer, transfer_of_bsdf, transfer_of_spectrum
    from mistray.estimate import Estimate
    from mistray.metrics.ranking import DirectImage
    from mistray.toolkit.irradiance import MapStatistics, log10_image, mirror_asymmetry, statistics
    from mistray.trace.host.ray_sources import DiskSource

__all__ = lazy_package(
    __name__,
    {
        "mistray.analyses.export.critical_rays": ("critical_rays",),
        "mistray.analyses.ghosts.field_summary": ("FieldSummary",),
        "mistray.analyses.ghosts.path_analysis": ("path_analysis",),
        "mistray.metrics.ranking": ("DirectImage",),
        "mistray.analyses.ghosts.result": ("GhostReport",),
        "mistray.analyses.ghosts.run": ("ghosts",),
        "mistray.analyses.image.result": ("FieldImage", "ImageQuality", "LineImage", "PointSpread"),
        "mistray.analyses.image.run": ("image_quality",),
        "mistray.analyses.objects.result": ("Objects",),
        "mistray.analyses.objects.run": ("objects",),
        "mistray.analyses.pst.first_level": ("FirstLevel", "first_level"),
        "mistray.analyses.pst.result": ("Pst",),
        "mistray.analyses.pst.run": ("pst",),
        "mistray.analyses.study.result": ("Study",),
        "mistray.analyses.study.run": ("study",),
        "mistray.analyses.thermal.result": ("ThermalReport",),
        "mistray.analyses.thermal.run": ("thermal",),
        "mistray.analyses.transfer.result": ("FieldTransfer", "Transfer"),
        "mistray.analyses.transfer.run": ("transfer",),
        "mistray.analyses.transfer.surface": ("SurfaceTransfer", "transfer_of_bsdf", "transfer_of_spectrum"),
        "mistray.estimate": ("Estimate",),
        "mistray.toolkit.irradiance": ("MapStatistics", "log10_image", "mirror_asymmetry", "statistics"),
        "mistray.trace.host.ray_sources": ("DiskSource",),
    },
)
