"""Recordings: what a sample is, where data sets lie, how labels are made."""
