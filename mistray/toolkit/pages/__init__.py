"""Reports: the self-contained HTML page of a result, and its CSV, JSON, PNG and PDF files."""
