"""Figures of results: their style, and pictures of traces and gradients, drawn by Matplotlib."""
