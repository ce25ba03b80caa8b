"""Float64 oracles for the tests; nothing here imports mistray."""
