"""The analysis of a system in eight steps."""
