"""The self-contained report.html of each result."""
