"""Resin jobs: read, rewritten in place, and made anew."""
