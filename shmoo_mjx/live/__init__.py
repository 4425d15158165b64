"""A page in the browser on which one sees the robot think, and moves things in its way."""
