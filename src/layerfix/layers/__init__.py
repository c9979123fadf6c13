"""One layer's pixels: the method of the paper, and what is measured on a layer."""
