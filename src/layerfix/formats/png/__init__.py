"""PNG images of layers."""
