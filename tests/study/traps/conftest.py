"""One test for each known pitfall: sections 7, 12 and 13 of the notes on method, by their numbers.

| pitfall | description | test |
|---|---|---|
| 7.1 | truth noise is fitted as odometry noise | section_7 test_1, ../test_likelihood (1 to 20 mm) |
| 7.2 | regressors that contain the noise | section_7 test_2, ../test_clean_data |
| 7.3 | a clock offset resembles slip and backlash | section_7 test_3 |
| 7.4, 12.6 | a clock offset from smoothed derivatives is biased | section_7 test_4 |
| 7.5 | a truth with coloured noise | section_7 test_5, section_12 test_1 |
| 7.6 | correlated noise and bursts resemble bias and scale | section_7 test_6 (slow), ../test_library (slow) |
| 7.7 | low power for causes that act in few places | section_7 test_7 (slow) |
| 7.8 | windows that overlap or reverse, zeros, other steps | section_7 test_8, ../test_compare_calibration,
  ../../sampling/test_samples |
| 7.9 | noise inflated by a cause that is found later | section_7 test_9 |
| 12.1 | assumed noise of a satellite truth | section_12 test_1 (two) |
| 12.2 | a controller that steers by the truth | section_12 test_2 |
| 12.3 | heading noise causes errors across | section_12 test_3 (slow), ../test_likelihood (dense normal) |
| 12.4 | any cause resembles Gauss-Markov noise | section_12 test_4 (slow), ../test_library (slow) |
| 12.5 | second-order artefacts | section_12 test_5 |
| 12.7 | lost increments have the mean effect of a scale | section_12 test_7 (two) |
| 12.8 | look-elsewhere effect of scans | section_12 test_8 |
| 12.9 | stamps as floats, truths with gaps | section_12 test_9, ../test_likelihood (gap) |
| 12.10 | noise law and tails cannot be separated | neither is named: no test can fail; `learn` takes the law as given |
| 12.11 | attainable error | benchmarks/hidden_effects.py, docs/hidden_effects.md |
| 13.1 | source of the regressors, odometry or truth | section_13 test_1 |
| 13.2 | causes that the drive does not excite | section_13 test_2 |
| 13.3 | linearisation at the values found | section_13 test_3 |
| 13.4 | clock of each recording, with skew | section_13 test_4 |
| 13.5 | effects that increase the drift, and pairs that compensate each other | test_drift_gate |
| 13.6 | noise law without false alarms | section_13 test_6; longer nodes where NEES grows (6b) are not done |
| 13.7 | robust weights, few and many | section_13 test_7 |
| 13.8 | the track | section_13 test_8 |
| 13.9 | backlash and time offset | section_13 test_9 (slow) |
| 13.10 | robots that drive sideways | section_13 test_10 |
| 13.11 | groups, directions and discs | section_13 test_11 |
| 13.12 | a flat NEES | section_13 test_12 |
"""

import sys
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1])]
