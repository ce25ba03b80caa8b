"""Sensitivity of a metric to parameters: effect of tolerances, helpful changes, and perturbed systems."""
