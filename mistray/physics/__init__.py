"""Pure equations: no scene, no Mitsuba. Units and sources stand in each module."""
