"""One test for each known pitfall: sections 7, 12 and 13 of the notes on method, by their numbers.

| trap | what it was | test |
|---|---|---|
| 7.1 | noise of the truth passes for noise of the odometry | section_7 test_1, ../test_likelihood (1 to 20 mm) |
| 7.2 | regressors that carry the noise | section_7 test_2, ../test_clean_data |
| 7.3 | a late clock looks like slip and play | section_7 test_3 |
| 7.4, 12.6 | an offset from smoothed derivatives is biased | section_7 test_4 |
| 7.5 | a truth whose noise is coloured | section_7 test_5, section_12 test_1 |
| 7.6 | wandering noise and bursts look like bias and scale | section_7 test_6 (slow), ../test_library (slow) |
| 7.7 | causes that act in few places lose their power | section_7 test_7 (slow) |
| 7.8 | windows that overlap or turn round, zeros, other steps | section_7 test_8, ../test_compare_calibration,
  ../../sampling/test_convert |
| 7.9 | noise that a found cause had inflated | section_7 test_9 |
| 12.1 | noise of satellites' truth that is assumed | section_12 test_1 (two) |
| 12.2 | a controller that steers on the truth | section_12 test_2 |
| 12.3 | noise of the heading leaks across | section_12 test_3 (slow), ../test_likelihood (dense normal) |
| 12.4 | everything looks like Gauss-Markov noise | section_12 test_4 (slow), ../test_library (slow) |
| 12.5 | ghosts of second order | section_12 test_5 |
| 12.7 | lost increments have the mean of a scale | section_12 test_7 (two) |
| 12.8 | scans look elsewhere | section_12 test_8 |
| 12.9 | stamps as floats, truths with holes | section_12 test_9, ../test_likelihood (gap) |
| 12.10 | law and tails cannot be decided | nothing names them: no test can fail; `learn` takes the law as given |
| 12.11 | what is attainable | benchmarks/hidden_effects.py, docs/hidden_effects.md |
| 13.1 | which side drives | section_13 test_1 |
| 13.2 | causes that the drive does not show | section_13 test_2 |
| 13.3 | linearise where a cause was found | section_13 test_3 |
| 13.4 | clocks of every recording, with skew | section_13 test_4 |
| 13.5 | what raises the drift, and pairs that make up for each other | test_drift_gate |
| 13.6 | the law without false alarms | section_13 test_6; longer nodes where NEES grows (6b) are not done |
| 13.7 | robust weights, few and many | section_13 test_7 |
| 13.8 | the track | section_13 test_8 |
| 13.9 | play and time offset | section_13 test_9 (slow) |
| 13.10 | robots that go sideways | section_13 test_10 |
| 13.11 | groups, directions and discs | section_13 test_11 |
| 13.12 | a flat NEES | section_13 test_12 |
"""

import sys
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1])]
