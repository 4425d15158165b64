"""Domain-randomisation sweeps: thousands of MJX worlds, one row each."""
