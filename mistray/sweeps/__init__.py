"""Names of sweeps and configurations, re-exported."""

from typing import TYPE_CHECKING

from mistray._lazy import lazy_package

if TYPE_CHECKING:
    from mistray.analyses.sweep.configurations import AS_IT_IS, Configuration
    from mistray.analyses.sweep.edit_ranking import EditRanking, rank_edits
    from mistray.analyses.sweep.pst_sweep import PstSweep, sweep_pst
    from mistray.analyses.sweep.read_configurations import read_configurations
    from mistray.analyses.sweep.result import Sweep
    from mistray.analyses.sweep.run import sweep
    from mistray.analyses.sweep.write_configuration import write_configuration

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
