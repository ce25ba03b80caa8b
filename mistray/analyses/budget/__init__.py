"""Budget of roughness and cleanliness: tolerances that keep stray light below limits at the least cost."""
