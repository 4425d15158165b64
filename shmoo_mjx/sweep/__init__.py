"""Domain-randomisation sweeps over thousands of MJX worlds, with one result row per world."""
