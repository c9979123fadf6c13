"""Build direction: the pose of a part that needs the least correction, found on one machine or on many."""
