"""The meso-skeleton by measure: skeletal paths that end where F just holds the feature's end, in any direction.

Lengths are Euclidean in the metric in which F is a disc (y scaled by r/ry, x by r/rx); r is F's radius, depth the
distance to the nearest void pixel.

  1 significance  (`cones`)    K: the pixels of S \\ M whose ball no deeper pixel's cone explains. x is explained by y
                               if |x - y| ≤ 2.4 · (depth(y) - depth(x)) + a little, reachable inside S: corners
                               blunter than 49° and bumps shorter than they are wide are, tips and strips are not
  2 thinning                   Guo–Hall around M and K, ends outside K removed; then around M and the tips of K
  3 retreat       (`retreat`)  every end walks back until F, drawn there, just holds the balls of what it walked over
  4 ends          (`ends`)     where F's pixels end nearly, but not quite where S does, the end is moved

The depths come as a stack of erosions by sums of small elements (`levels`), 64 pixels a word. Deletions are by
anchored Guo–Hall, by `remove_spurs`, or one at a time of simple pixels, so that the topology of S is kept.
"""

from layerfix.layers.metric.rule import thin_metric

__all__ = ["thin_metric"]
