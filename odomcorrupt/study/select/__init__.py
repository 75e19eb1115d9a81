"""Model selection: stepwise inclusion of the terms that a model lacks.

In the order of the procedure: `stepwise` (the loop), `screening` and `shape_search` (approximate gains of all terms and
their best shapes), `score` (tests), `candidates` (refits, admission and refusal), `dependence` and `periodic` (basis
functions for causes outside the library), `random_effects` (correlated noise and outliers), `model_comparison` (effects
against basis functions), `elimination` (redundant terms), `heterogeneity` (differences between recordings),
`confidence` (probabilities), and `decisions` (thresholds and their reasons). Terms are defined in
`odomcorrupt.study.terms`.
"""
