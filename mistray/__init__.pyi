"""mistray: stray light in optical systems, on Mitsuba 3 and Dr.Jit."""

# Written by tests/stubs.py from what the functions are when they run

from types import ModuleType

from mistray import analysis as analysis
from mistray import coatings as coatings
from mistray import materials as materials
from mistray import mechanics as mechanics
from mistray import optimize as optimize
from mistray import physics as physics
from mistray import prescription as prescription
from mistray import report as report
from mistray import scatter as scatter
from mistray import scene as scene
from mistray import sweeps as sweeps
from mistray._variant import ensure_variant as ensure_variant
from mistray._variant import set_threads as set_threads
from mistray.analysis import FirstLevel as FirstLevel
from mistray.analysis import GhostReport as GhostReport
from mistray.analysis import ImageQuality as ImageQuality
from mistray.analysis import Objects as Objects
from mistray.analysis import Pst as Pst
from mistray.analysis import Study as Study
from mistray.analysis import ThermalReport as ThermalReport
from mistray.analysis import Transfer as Transfer
from mistray.analysis import first_level as first_level
from mistray.analysis import ghosts as ghosts
from mistray.analysis import image_quality as image_quality
from mistray.analysis import objects as objects
from mistray.analysis import pst as pst
from mistray.analysis import study as study
from mistray.analysis import thermal as thermal
from mistray.analysis import transfer as transfer
from mistray.cluster import distribute as distribute
from mistray.errors import MistrayError as MistrayError
from mistray.errors import MistrayWarning as MistrayWarning
from mistray.errors import UnfinishedError as UnfinishedError
from mistray.explore import Explorer as Explorer
from mistray.optimize import Metric as Metric
from mistray.optimize import gradient as gradient
from mistray.optimize import sensitivity as sensitivity
from mistray.prescription import Coating as Coating
from mistray.prescription import Detector as Detector
from mistray.prescription import Prescription as Prescription
from mistray.prescription import Scatter as Scatter
from mistray.prescription import Source as Source
from mistray.prescription import Structure as Structure
from mistray.prescription import Surface as Surface
from mistray.report import ProgressBar as ProgressBar
from mistray.report import StepExport as StepExport
from mistray.report import View as View
from mistray.report import export_step as export_step
from mistray.report import load_result as load_result
from mistray.report import view as view
from mistray.scene import coat as coat
from mistray.scene import load as load
from mistray.sweeps import Sweep as Sweep
from mistray.sweeps import sweep as sweep
from mistray.trace import Trace as Trace
from mistray.trace import trace as trace

__version__: str
scenes: ModuleType

__all__ = [
    "Coating",
    "Detector",
    "Explorer",
    "FirstLevel",
    "GhostReport",
    "ImageQuality",
    "Metric",
    "MistrayError",
    "MistrayWarning",
    "Objects",
    "Prescription",
    "ProgressBar",
    "Pst",
    "Scatter",
    "Source",
    "StepExport",
    "Structure",
    "Study",
    "Surface",
    "Sweep",
    "ThermalReport",
    "Trace",
    "Transfer",
    "UnfinishedError",
    "View",
    "__version__",
    "analysis",
    "coat",
    "coatings",
    "distribute",
    "ensure_variant",
    "export_step",
    "first_level",
    "ghosts",
    "gradient",
    "image_quality",
    "load",
    "load_result",
    "materials",
    "mechanics",
    "objects",
    "optimize",
    "physics",
    "prescription",
    "pst",
    "report",
    "scatter",
    "scene",
    "scenes",
    "sensitivity",
    "set_threads",
    "study",
    "sweep",
    "sweeps",
    "thermal",
    "trace",
    "transfer",
    "view",
]
