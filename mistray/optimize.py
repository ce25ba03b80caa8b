"""Public names of metrics, gradients, tolerances and design, re-exported."""

from mistray._lazy import lazy_package

__all__ = lazy_package(
    __name__,
    {
        "mistray.analyses.budget.result": ("Budget",),
        "mistray.analyses.budget.run": ("budget",),
        "mistray.analyses.optimize.study.comparison": ("Comparison", "Levels", "compare", "measure"),
        "mistray.analyses.optimize.study.model": (
            "CoatingGroup",
            "DesignStudy",
            "Moved",
            "Optimizer",
            "Study",
            "Term",
            "VariableGroup",
        ),
        "mistray.analyses.optimize.study.optimization": ("Optimization", "optimize"),
        "mistray.analyses.optimize.study.state": ("Start", "Step"),
        "mistray.analyses.optimize.toml.read_study": ("read_study",),
        "mistray.analyses.fit.run": ("Evaluations", "Fit", "fit"),
        "mistray.analyses.pst.metrics.pst_bands": ("Modelled", "PstBands"),
        "mistray.analyses.pst.metrics.pst_metrics": ("pst_band", "pst_bin", "pst_mask", "veiling_glare"),
        "mistray.analyses.pst.metrics.pst_observation": ("PstObservation",),
        "mistray.analyses.sensitivity.result": ("Sensitivity",),
        "mistray.analyses.sensitivity.run": ("sensitivity",),
        "mistray.metrics.bodies": ("Body", "bodies"),
        "mistray.metrics.combined_metric": ("combine",),
        "mistray.metrics.gradient": ("Gradient", "gradient"),
        "mistray.metrics.metric": (
            "Metric",
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
