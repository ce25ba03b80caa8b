"""Import of systems of other programs as scenes, with a check that light still reaches their detector."""
