"""Coverage-guided fuzzing of the readers, for longer than a test may take; see `__main__`."""
