"""Search for critical, illuminated and common objects of a scene."""
