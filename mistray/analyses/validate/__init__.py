"""Validation: published numbers and other programs beside ours, with a verdict on each."""
