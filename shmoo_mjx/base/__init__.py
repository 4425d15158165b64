"""Utilities shared by all packages: files, input checks, progress, seeds, versions."""
