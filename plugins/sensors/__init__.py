"""Plugins for sensors, one per file, which is named after the plugin."""
