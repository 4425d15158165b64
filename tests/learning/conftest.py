"""Synthetic objects for what learns."""

from __future__ import annotations

from synthetic import synthetic_dataset, synthetic_directory

__all__ = ["synthetic_dataset", "synthetic_directory"]
