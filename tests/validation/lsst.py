"""Rubin/LSST in the r band, ray by ray beside batoid's split trace, see `validation.beside_batoid`."""

from __future__ import annotations

from validation.beside_batoid import Telescope, differences

TELESCOPE = Telescope("LSST_r.yaml", 620.0)
compare, label = TELESCOPE.compare, TELESCOPE.label

__all__ = ["TELESCOPE", "compare", "differences", "label"]
