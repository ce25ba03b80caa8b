"""Sensor plugins, one per file; the file is named after the plugin."""
