"""Paired evaluation of policies: players, metrics, statistics, and the files it leaves."""
