"""Searching for good values: Optuna proposes points of a space, trials score them on tuning seeds."""
