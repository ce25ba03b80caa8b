"""Toolkit of analyses: requests give signatures and options, rows give tables; pages, figures, drawings, PDF."""
