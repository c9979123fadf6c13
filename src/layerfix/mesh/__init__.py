"""Meshes: read, closed, sliced to a stack."""
