"""How rays with the light and rays against it share paths: where the first start, and who counts what."""
