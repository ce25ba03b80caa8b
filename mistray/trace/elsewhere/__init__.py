"""Light anywhere but on the detector: its rays, its maps, and which of it a filter lets through."""
