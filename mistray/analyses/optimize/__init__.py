"""Design by gradients: studies that minimise stray light over coatings, shapes, positions and scatter."""
