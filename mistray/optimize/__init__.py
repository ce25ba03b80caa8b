"""Making stray light small: metrics, their gradients, and the designs that follow from them."""

from typing import TYPE_CHECKING

from mistray._lazy import lazy_package

if TYPE_CHECKING:
    from mistray.optimize.bodies import Body, bodies
    from mistray.optimize.fit import Evaluations, Fit, fit
    from mistray.optimize.gradient import Gradient, gradient
    from mistray.optimize.metrics.metric import (
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
    from mistray.optimize.metrics.observation import Observation, smooth_maximum, smooth_minimum
    from mistray.optimize.metrics.pst_metrics import pst_band, pst_bin, pst_mask, veiling_glare
    from mistray.optimize.metrics.pst_observation import PstObservation
    from mistray.optimize.parameters import Parameter, groups, match, parameters
    from mistray.optimize.pst_bands import Modelled, PstBands
    from mistray.optimize.study.comparison import Comparison, Levels, compare, measure
    from mistray.optimize.study.model import CoatingGroup, DesignStudy, Moved, Optimizer, Study, Term, VariableGroup
    from mistray.optimize.study.optimization import Optimization, optimize
    from mistray.optimize.study.state import Start, Step
    from mistray.optimize.tolerances.budget import Budget, budget
    from mistray.optimize.tolerances.sensitivity import Sensitivity, sensitivity
    from mistray.optimize.toml.read_study import read_study

__all__ = lazy_package(
    __name__,
    {
        "bodies": ("Body", "bodies"),
        "tolerances.budget": ("Budget", "budget"),
        "fit": ("Evaluations", "Fit", "fit"),
        "gradient": ("Gradient", "gradient"),
        "metrics.metric": (
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
        "metrics.observation": ("Observation", "smooth_maximum", "smooth_minimum"),
        "parameters": ("Parameter", "groups", "match", "parameters"),
        "metrics.pst_metrics": ("pst_band", "pst_bin", "pst_mask", "veiling_glare"),
        "pst_bands": ("Modelled", "PstBands"),
        "metrics.pst_observation": ("PstObservation",),
        "toml.read_study": ("read_study",),
        "study.optimization": ("Optimization", "optimize"),
        "tolerances.sensitivity": ("Sensitivity", "sensitivity"),
        "study.state": ("Start", "Step"),
        "study.model": ("CoatingGroup", "DesignStudy", "Moved", "Optimizer", "Study", "Term", "VariableGroup"),
        "study.comparison": ("Comparison", "Levels", "compare", "measure"),
    },
)
