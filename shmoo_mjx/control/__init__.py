"""Control: a model-agnostic MPPI planner, and the cost and controller for pushing an object to a goal."""
