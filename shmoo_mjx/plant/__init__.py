"""The simulated world: robot, objects, scenes, low-level control, and the engines that step them."""
