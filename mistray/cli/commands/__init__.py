"""Commands of `mistray` that are not analyses, one file each."""
