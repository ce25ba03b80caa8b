"""Surfaces as the kernel and the host intersect them: geometry, nearest hits, media and coatings."""

from mistray._variant import active_variant, ensure_variant

if active_variant() is None:  # types of the variant are used while modules are imported
    ensure_variant()
