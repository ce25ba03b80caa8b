"""Reader of design studies in TOML, which checks every key and value."""
