"""Runnable modules behind the ``impact`` command: training, evaluation, report."""
