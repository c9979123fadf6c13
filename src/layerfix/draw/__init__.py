"""Pictures: layers before and after, beads, plots."""
