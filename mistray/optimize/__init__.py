"""Making stray light small: metrics, their gradients, and the designs that follow from them."""

from mistray.optimize.gradient import Gradient, gradient
from mistray.optimize.metrics import Metric, Observation, ghost_to_signal, image_metric, path_power

__all__ = ["Gradient", "Metric", "Observation", "ghost_to_signal", "gradient", "image_metric", "path_power"]
