"""Systems of other programs made into scenes, and whether light still reaches their detector."""
