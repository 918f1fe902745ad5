"""One control period of one world: observe, replan, track; replanning in the background."""
