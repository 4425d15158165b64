"""Planar poses, faces of objects, and hand positions."""
