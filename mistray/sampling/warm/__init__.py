"""Light that warm surfaces emit, as sources of a forward trace."""
