"""States of polarisation."""
