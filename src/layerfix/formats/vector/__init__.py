"""Outlines and paths as files."""
