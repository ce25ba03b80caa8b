"""Making stray light small: metrics, their gradients, and the designs that follow from them."""

from typing import TYPE_CHECKING

from mistray._lazy import lazy_package

if TYPE_CHECKING:
    from mistray.optimize.budget import Budget, budget
    from mistray.optimize.fit import Fit, fit
    from mistray.optimize.gradient import Gradient, gradient
    from mistray.optimize.metrics import (
        Metric,
        combine,
        ghost_focus,
        ghost_rms_irradiance,
        ghost_to_signal,
        image_metric,
        log,
        path_power,
        peak_irradiance,
        relative_illumination,
        rms_spot,
        transmission,
    )
    from mistray.optimize.observation import Observation, smooth_maximum, smooth_minimum
    from mistray.optimize.parameters import Parameter, groups, match, parameters
    from mistray.optimize.pst_metrics import pst_band, pst_bin, pst_mask, veiling_glare
    from mistray.optimize.pst_model import Modelled, PstBands
    from mistray.optimize.pst_observation import PstObservation
    from mistray.optimize.read_study import read_study
    from mistray.optimize.run import Optimization, optimize
    from mistray.optimize.sensitivity import Sensitivity, sensitivity
    from mistray.optimize.state import Start, Step
    from mistray.optimize.study import CoatingGroup, Moved, Optimizer, Study, Term, VariableGroup
    from mistray.optimize.verify import Comparison, Levels, compare, measure

__all__ = [
    "Budget",
    "CoatingGroup",
    "Comparison",
    "Fit",
    "Gradient",
    "Levels",
    "Metric",
    "Modelled",
    "Moved",
    "Observation",
    "Optimization",
    "Optimizer",
    "Parameter",
    "PstBands",
    "PstObservation",
    "Sensitivity",
    "Start",
    "Step",
    "Study",
    "Term",
    "VariableGroup",
    "budget",
    "combine",
    "compare",
    "fit",
    "ghost_focus",
    "ghost_rms_irradiance",
    "ghost_to_signal",
    "gradient",
    "groups",
    "image_metric",
    "log",
    "match",
    "measure",
    "optimize",
    "parameters",
    "path_power",
    "peak_irradiance",
    "pst_band",
    "pst_bin",
    "pst_mask",
    "read_study",
    "relative_illumination",
    "rms_spot",
    "sensitivity",
    "smooth_maximum",
    "smooth_minimum",
    "transmission",
    "veiling_glare",
]

lazy_package(
    __name__,
    {
        "budget": ("Budget", "budget"),
        "fit": ("Fit", "fit"),
        "gradient": ("Gradient", "gradient"),
        "metrics": (
            "Metric",
            "combine",
            "ghost_focus",
            "ghost_rms_irradiance",
            "ghost_to_signal",
            "image_metric",
            "log",
            "path_power",
            "peak_irradiance",
            "relative_illumination",
            "rms_spot",
            "transmission",
        ),
        "observation": ("Observation", "smooth_maximum", "smooth_minimum"),
        "parameters": ("Parameter", "groups", "match", "parameters"),
        "pst_metrics": ("pst_band", "pst_bin", "pst_mask", "veiling_glare"),
        "pst_model": ("Modelled", "PstBands"),
        "pst_observation": ("PstObservation",),
        "read_study": ("read_study",),
        "run": ("Optimization", "optimize"),
        "sensitivity": ("Sensitivity", "sensitivity"),
        "state": ("Start", "Step"),
        "study": ("CoatingGroup", "Moved", "Optimizer", "Study", "Term", "VariableGroup"),
        "verify": ("Comparison", "Levels", "compare", "measure"),
    },
)
