"""Whether the numbers of a trace can be trusted: what was cut, and how scattered light was sampled."""
