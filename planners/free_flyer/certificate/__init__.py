"""An independent check of plan files for discs, in exact arithmetic over continuous time.

It shares no code with the planner: it reads the file itself, knows curves only as polynomials with rational
coefficients, and decides every sign with exact numbers. What it takes from the project is the scenario (who is where,
limits, areas) and the parsed formula.
"""
