"""One motion drawn many times: samples, moments, densities, and what the coefficients of one law are in another."""
