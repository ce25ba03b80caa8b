"""Sources, start rays, and importance targets at which scattered rays are aimed."""

from mistray._variant import active_variant, ensure_variant

if active_variant() is None:  # modules use types of the variant while they are imported
    ensure_variant()
