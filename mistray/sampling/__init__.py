"""Where rays start and where scattered ones are sent: sources, start rays, importance targets."""

from mistray._variant import active_variant, ensure_variant

if active_variant() is None:  # types of the variant are used while modules are imported
    ensure_variant()
