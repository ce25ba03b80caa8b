"""Reader of lenses in CODE V command files (.seq)."""
