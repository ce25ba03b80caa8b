"""Traces in passes: launches, parts for other processes, time and interrupts."""

from mistray._variant import active_variant, ensure_variant

if active_variant() is None:  # types of the variant are used while modules are imported
    ensure_variant()
