"""Plugins for integrators, one per file, which is named after the plugin."""
