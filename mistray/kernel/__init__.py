"""Kernel of the traces: ray trees, interactions at surfaces, branching, scatter and MIS densities."""

from mistray._variant import active_variant, ensure_variant

if active_variant() is None:  # types of the variant are used while modules are imported
    ensure_variant()
