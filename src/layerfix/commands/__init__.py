"""Whole tasks, one call each; what the command line, and a program that embeds layerfix, calls."""
