"""Terms of the regression: what explains the residual of odometry against truth."""
