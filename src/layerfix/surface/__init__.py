"""The corrected surface: a stack as a closed triangle mesh, in three kinds (`layerfix.surface.kinds`)."""
