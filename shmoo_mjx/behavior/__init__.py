"""Behaviour of the robot: skills, the state machine for pushing, decisions, the navigator and the push task."""
