"""Terms of the regression: hypotheses that may explain the residual of odometry against truth.

`regressors` (the smooth motion on which all terms depend), `basis` (functions of one regressor), `channels` (their
actions on the body or on wheels), `splines` (curves), `term` (library effects and basis functions under one protocol),
and `drive_type` and `heading_source` (effects that the robot can have).
"""
