"""Export of scenes as STEP files: lenses, mirrors, mechanics, clear beams and stray paths."""
