"""Search for critical, illuminated and common objects: those the detector sees, those that are lit, and both."""
