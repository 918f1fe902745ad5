"""The plan of most robustness: a mixed-integer program over events, then smooth curves."""
