"""Metrics of a scene to be minimised or maximised: values, parameters and derivatives."""
