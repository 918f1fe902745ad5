"""The plan for the greatest deviation of an object after each impact: boxes that every flight stays in."""
