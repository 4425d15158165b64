"""A browser page that shows a simulation with the robot's plans and estimates, and lets the user change the world."""
