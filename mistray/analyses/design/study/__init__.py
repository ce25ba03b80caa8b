"""A study: terms, variables and coatings, its merit, its start points, its searches and the proof of what they find."""
