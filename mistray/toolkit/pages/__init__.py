"""Self-contained report.html of each result, and the other files of a report."""
