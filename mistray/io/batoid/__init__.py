"""Reader of telescopes of the program batoid (.yaml)."""
