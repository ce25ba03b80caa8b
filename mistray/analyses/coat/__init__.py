"""Put coatings, paint and scatter on surfaces of a scene by name."""
