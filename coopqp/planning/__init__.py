"""Paths on the closure manifold, before anything moves: how fast they can be followed."""
