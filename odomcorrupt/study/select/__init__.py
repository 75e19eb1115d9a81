"""Model selection: which terms a model lacks.

In the order of the procedure: `stepwise` (the loop), `screening` and `shape_search` (which terms, at which shape, might
explain the residual), `score` (tests), `candidates` (refitted and admitted or refused), `dependence` and `periodic`
(basis functions where the library has nothing), `random_effects` (correlated noise and outliers), `model_comparison`
(effects against basis functions), `elimination` (what becomes redundant), `closed_loop` (what a controller does),
`heterogeneity` (recordings that disagree), `confidence` (probabilities), and `decisions` (every threshold, with its
reason). What a term is, is said in `odomcorrupt.study.terms`.
"""
