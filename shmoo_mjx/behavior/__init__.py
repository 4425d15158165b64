"""What the robot does: skills, one machine that deals with an object, decisions, navigator and pushing task."""
