"""Sensitivity of a metric to parameters: effect of tolerances, useful changes, and perturbed systems."""
