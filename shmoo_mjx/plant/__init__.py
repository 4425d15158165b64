"""The simulated world: robot, objects, scenes, low-level control and the physics engines."""
