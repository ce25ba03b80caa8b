"""Surfaces as the kernel and the host intersect them: pieces, their numbers, hits, media and coatings behind them."""

from mistray._variant import active_variant, ensure_variant

if active_variant() is None:  # types of the variant are used while modules are imported
    ensure_variant()
