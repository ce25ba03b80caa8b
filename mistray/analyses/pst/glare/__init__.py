"""Numbers that follow from a PST: ratios, glare, extended sources."""
