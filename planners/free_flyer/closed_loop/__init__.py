"""One control period of one world: observe, replan, track; new plans in the background."""
