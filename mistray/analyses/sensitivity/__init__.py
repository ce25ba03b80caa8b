"""How parameters within their tolerances change a metric, which changes help, and what tolerances a limit needs."""
