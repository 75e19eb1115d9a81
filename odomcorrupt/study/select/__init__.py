"""Model selection: the terms that a model lacks, found by their joint evidence on left-out data.

In the order of the procedure: `selection` (rounds), `dictionary` (terms that compete, and their columns), `evidence`
(sets of terms, and scores of single ones, by sums of matrices over folds). They use `shape_search` (approximate gains
of all terms and their best shapes), `periodic` (waves over the distance) and `random_effects` (correlated noise and
outliers). The result is `result`, with tests of single effects and curves (`candidates`), probabilities (`confidence`),
sizes (`contribution`) and differences between recordings (`heterogeneity`). Prior odds and thresholds, with their
reasons, are in `decisions`. Terms are defined in `odomcorrupt.study.terms`.
"""
