"""Derivatives of what a trace has found: replay of paths, edges, chain rules to parameters."""

from mistray._variant import active_variant, ensure_variant

if active_variant() is None:  # types of the variant are used while modules are imported
    ensure_variant()
