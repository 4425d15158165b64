"""Experiments: each measures one claim on held-out conditions and leaves one JSON and its figures."""
