"""Analyses: one folder a capability, with its request, its run, its result, its page and its command."""
