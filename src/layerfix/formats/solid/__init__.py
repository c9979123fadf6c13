"""Meshes as files."""
