"""What a change of a scene does beside what it is meant to do: gaps that open, light that enters by other surfaces."""
