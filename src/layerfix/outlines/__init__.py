"""Outlines of layers, and the solid they stack up to."""
