"""Poses in the plane, faces of objects, places of the hands."""
