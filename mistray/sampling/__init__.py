"""Sources, start rays, importance targets of scattered rays, and MIS weights of forward and backward rays."""

from mistray._variant import active_variant, ensure_variant

if active_variant() is None:  # modules use types of the variant while they are imported
    ensure_variant()
