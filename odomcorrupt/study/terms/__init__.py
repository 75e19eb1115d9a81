"""Terms of the regression: hypotheses that may explain the residual of odometry against truth.

`basis` (functions of one regressor, and its curves), `channels` (their actions on the body or on wheels), `term`
(library effects that a robot can have, and basis functions, under one protocol).
"""
