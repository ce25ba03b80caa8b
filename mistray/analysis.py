"""Public names of the analyses, re-exported: ghosts, point source transmittance, thermal emission, whole studies."""

from mistray._lazy import lazy_package

__all__ = lazy_package(
    __name__,
    {
        "mistray.analyses.export.critical_rays": ("critical_rays",),
        "mistray.analyses.ghosts.field_summary": ("FieldSummary",),
        "mistray.analyses.ghosts.path_analysis": ("path_analysis",),
        "mistray.metrics.ghost_ranking": ("DirectImage",),
        "mistray.analyses.ghosts.result": ("GhostReport",),
        "mistray.analyses.ghosts.run": ("ghosts",),
        "mistray.analyses.image.line_image": ("LineImage", "PointSpread"),
        "mistray.analyses.image.result": ("FieldImage", "ImageQuality"),
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
