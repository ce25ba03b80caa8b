"""Grid source, lens, reflector, target: the ray-sorting example of a TracePro webinar."""
