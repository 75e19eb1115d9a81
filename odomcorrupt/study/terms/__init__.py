"""Terms of the regression: hypotheses that may explain the residual of odometry against truth.

`basis` (functions of one regressor), `channels` (their actions on the body or on wheels), `splines` (curves), `term`
(library effects that a robot can have, and basis functions, under one protocol).
"""
