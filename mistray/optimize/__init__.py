"""Names of metrics, gradients, tolerances and design, re-exported."""

from typing import TYPE_CHECKING

from mistray._lazy import lazy_package

if TYPE_CHECKING:
    from mistray.analyses.budget.result import Budget
    from mistray.analyses.budget.run import budget
    from mistray.analyses.design.study.comparison import Comparison, Levels, compare, measure
    from mistray.analyses.design.study.model import (
        CoatingGroup,
        DesignStudy,
        Moved,
        Optimizer,
        Study,
        Term,
        VariableGroup,
    )
    from mistray.analyses.design.study.optimization import Optimization, optimize
    from mistray.analyses.design.study.state import Start, Step
    from mistray.analyses.design.toml.read_study import read_study
    from mistray.analyses.fit.run import Evaluations, Fit, fit
    from mistray.analyses.pst.metrics.pst_bands import Modelled, PstBands
    from mistray.analyses.pst.metrics.pst_metrics import pst_band, pst_bin, pst_mask, veiling_glare
    from mistray.analyses.pst.metrics.pst_observation import PstObservation
    from mistray.analyses.sensitivity.result import Sensitivity
    from mistray.analyses.sensitivity.run import sensitivity
    from mistray.metrics.bodies import Body, bodies
    from mistray.metrics.gradient import Gradient, gradient
    from mistray.metrics.metric import (
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
    from mistray.metrics.observation import Observation, smooth_maximum, smooth_minimum
    from mistray.metrics.parameters import Parameter, groups, match, parameters

__all__ = lazy_package(
    __name__,
    {
        "mistray.analyses.budget.result": ("Budget",),
        "mistray.analyses.budget.run": ("budget",),
        "mistray.analyses.design.study.comparison": ("Comparison", "Levels", "compare", "measure"),
        "mistray.analyses.design.study.model": (
            "CoatingGroup",
            "DesignStudy",
            "Moved",
            "Optimizer",
            "Study",
            "Term",
            "VariableGroup",
        ),
        "mistray.analyses.design.study.optimization": ("Optimization", "optimize"),
        "mistray.analyses.design.study.state": ("Start", "Step"),
        "mistray.analyses.design.toml.read_study": ("read_study",),
        "mistray.analyses.fit.run": ("Evaluations", "Fit", "fit"),
        "mistray.analyses.pst.metrics.pst_bands": ("Modelled", "PstBands"),
        "mistray.analyses.pst.metrics.pst_metrics": ("pst_band", "pst_bin", "pst_mask", "veiling_glare"),
        "mistray.analyses.pst.metrics.pst_observation": ("PstObservation",),
        "mistray.analyses.sensitivity.result": ("Sensitivity",),
        "mistray.analyses.sensitivity.run": ("sensitivity",),
        "mistray.metrics.bodies": ("Body", "bodies"),
        "mistray.metrics.gradient": ("Gradient", "gradient"),
        "mistray.metrics.metric": (
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
        "mistray.metrics.observation": ("Observation", "smooth_maximum", "smooth_minimum"),
        "mistray.metrics.parameters": ("Parameter", "groups", "match", "parameters"),
    },
)
