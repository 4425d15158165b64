"""Maps, path planning, local trajectories, and prediction of where pushes lead."""
