"""Execution of traces in passes: kernel launches, work shared with other processes, time limits and interrupts."""

from mistray._variant import active_variant, ensure_variant

if active_variant() is None:  # modules use types of the variant while they are imported
    ensure_variant()
