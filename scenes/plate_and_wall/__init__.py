"""A glass plate and a grey screen before a detector: one scatter at either."""
