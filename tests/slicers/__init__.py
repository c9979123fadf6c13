"""What real slicers make of parts before and after correction: ``python -m tests.slicers``."""
