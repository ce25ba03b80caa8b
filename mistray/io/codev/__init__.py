"""CODE V command files (.seq)."""
