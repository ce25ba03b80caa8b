"""What is to be small or large: metrics of traces and of point source transmittances, and what they look at."""
