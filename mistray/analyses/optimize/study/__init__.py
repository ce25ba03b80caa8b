"""Optimisation of a study: terms, variables and coatings, merit, starts, searches and verification on other seeds."""
