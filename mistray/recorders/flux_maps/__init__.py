"""Recorders that leave the light as it is: on a rectangle in space, on surfaces, or by direction far away."""
