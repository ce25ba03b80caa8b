"""Stray-light study of a system in eight steps, from the optical model to stray-light analysis."""
