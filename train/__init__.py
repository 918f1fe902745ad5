"""What is run: training scripts, evaluation, report, and the ``impact`` command.

A folder named as a domain says in its ``__init__`` what the domain brings here (see impact_envs.domain); it may lack
any of:

    RECORD          class that watches an episode: made of (scenario, policy); ``add(env)`` after reset and steps
    FIGURES         (record, episode) -> what ``impact run`` prints besides the metrics
    PICTURE         (record, episode, path): draw a whole episode into a file
    PLAN_PICTURE    (scenario, plan, path): draw a plan into a file
    METRICS         tuple of evaluation.metric.Metric: what an evaluation measures besides
    UNITS           units of what ``impact run`` prints, by key, where they are not the usual ones
    OUTCOMES        scenario to why its expert's episode, as published, ends without success
    LINKS           (scenario) -> what a replay needs to draw arms

and a file ``paper.toml``: the published numbers, and the commands that compute them here (see papers.paper).
"""
