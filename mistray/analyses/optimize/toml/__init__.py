"""Read studies from TOML and check every key and value."""
