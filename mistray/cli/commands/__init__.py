"""Commands of the command line that are no analyses, one file each."""
