"""Follow a reference: the robot's course, and the controllers that track it."""
