"""Sequential lens: a table of surfaces in the order of light, with its rays and first-order data."""
