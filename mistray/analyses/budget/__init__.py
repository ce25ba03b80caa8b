"""Tolerances within which limits on stray light hold, at the least cost."""
