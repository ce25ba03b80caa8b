"""A lens behind a tube with vanes that leave no first-order path to it."""
