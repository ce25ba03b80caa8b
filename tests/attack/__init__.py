"""An attack on mistray by seed: through the command line and the public functions, as a user or an enemy would."""
