"""Maps, paths and trajectories, the object planner, and the navigator."""
