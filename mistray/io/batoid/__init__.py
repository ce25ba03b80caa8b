"""Reader of batoid telescopes (.yaml)."""
