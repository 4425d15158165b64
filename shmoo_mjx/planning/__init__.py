"""Maps, paths and local trajectories of the robot, and where pushes lead."""
