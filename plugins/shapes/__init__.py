"""Plugins for shapes, one per file, which is named after the plugin."""
