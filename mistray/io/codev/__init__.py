"""Reader of CODE V command files (.seq)."""
