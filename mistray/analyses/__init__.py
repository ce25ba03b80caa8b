"""Analyses: one folder for each capability, with its request, run, result, page and command."""
