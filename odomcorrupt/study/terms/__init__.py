"""Terms of the regression: what may explain the residual of odometry against truth.

`regressors` (the smooth motion that everything is a function of), `basis` (functions of one regressor) and `channels`
(what they act on), `splines` (curves), and `term` (effects of the library and basis functions as one kind of
hypothesis).
"""
