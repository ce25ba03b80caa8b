"""Commands of `mistray` that are no analyses, one file each."""
