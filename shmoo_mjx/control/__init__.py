"""Choosing the next action: a model-agnostic MPPI planner and the cost of pushing an object to a goal."""
