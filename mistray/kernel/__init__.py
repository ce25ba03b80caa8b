"""The ray tree: where a ray goes next, what happens there, how it branches and scatters."""

from mistray._variant import active_variant, ensure_variant

if active_variant() is None:  # types of the variant are used while modules are imported
    ensure_variant()
