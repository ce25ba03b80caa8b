"""Fields × wavelengths × configurations of a scene, all traced in one call with the kernels compiled once."""

from mistray.sweeps.configurations import AS_IT_IS, Configuration
from mistray.sweeps.edit_ranking import EditRanking, rank_edits
from mistray.sweeps.pst_sweep import PstSweep, sweep_pst
from mistray.sweeps.read_configurations import read_configurations
from mistray.sweeps.result import Sweep
from mistray.sweeps.trace_rows import sweep
from mistray.sweeps.write_configuration import write_configuration

__all__ = [
    "AS_IT_IS",
    "Configuration",
    "EditRanking",
    "PstSweep",
    "Sweep",
    "rank_edits",
    "read_configurations",
    "sweep",
    "sweep_pst",
    "write_configuration",
]


def __dir__() -> list[str]:
    return sorted(__all__)
