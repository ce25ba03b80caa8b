"""Public names of sweeps and configurations, re-exported."""

from mistray._lazy import lazy_package

__all__ = lazy_package(
    __name__,
    {
        "mistray.analyses.sweep.configurations": ("AS_IT_IS", "Configuration"),
        "mistray.analyses.sweep.edit_ranking": ("EditRanking", "rank_edits"),
        "mistray.analyses.sweep.pst_sweep": ("PstSweep", "sweep_pst"),
        "mistray.analyses.sweep.read_configurations": ("read_configurations",),
        "mistray.analyses.sweep.result": ("Sweep",),
        "mistray.analyses.sweep.run": ("sweep",),
        "mistray.analyses.sweep.write_configuration": ("write_configuration",),
    },
)
