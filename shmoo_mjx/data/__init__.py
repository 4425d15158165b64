"""Recordings: samples, data sets on disk, and labels for the learners."""
