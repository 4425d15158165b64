"""Runs: the simulation loop, an episode and its recording, and the commands that make or show a run."""
