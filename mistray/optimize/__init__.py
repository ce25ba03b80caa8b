"""Making stray light small: metrics, their gradients, and the designs that follow from them."""

from mistray.optimize.checkpoint import Step
from mistray.optimize.coatings import Optimization, optimize_coatings
from mistray.optimize.designs import Design
from mistray.optimize.gradient import Gradient, gradient
from mistray.optimize.metrics import Metric, Observation, ghost_to_signal, image_metric, path_power
from mistray.optimize.read_study import read_study
from mistray.optimize.study import CoatingGroup, MetricStudy, Optimizer, Study
from mistray.optimize.verify import Comparison, Levels, compare, measure

__all__ = [
    "CoatingGroup",
    "Comparison",
    "Design",
    "Gradient",
    "Levels",
    "Metric",
    "MetricStudy",
    "Observation",
    "Optimization",
    "Optimizer",
    "Step",
    "Study",
    "compare",
    "ghost_to_signal",
    "gradient",
    "image_metric",
    "measure",
    "optimize_coatings",
    "path_power",
    "read_study",
]
