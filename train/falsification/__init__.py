"""Where a policy fails: a search over what a suite draws, the mildest failures of each cause, and a suite of them."""
