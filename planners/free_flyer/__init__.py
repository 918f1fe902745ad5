"""Free-flyers: plans by mixed-integer programming, their execution by replanning and tracking."""
