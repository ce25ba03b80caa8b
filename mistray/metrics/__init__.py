"""Metrics of a scene to be minimised or maximised: values, parameters, derivatives, and side effects of changes."""
