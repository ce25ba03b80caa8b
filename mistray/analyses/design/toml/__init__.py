"""Studies and budgets from TOML, every key and value checked."""
