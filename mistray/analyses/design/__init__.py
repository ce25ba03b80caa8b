"""Design by derivatives: studies that make merit functions small."""
