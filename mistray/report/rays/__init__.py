"""Rays of chosen paths, and the files that hold them."""
