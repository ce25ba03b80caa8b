"""Light on any surface other than the detector: its rays, its maps, and filters of it."""
