"""One thread of linear algebra a process, as the command line sets it.

Tests run side by side, a worker a core, and threads of OpenBLAS spin while they wait for a core: a decomposition that
takes milliseconds then takes minutes. The variable has to be there before numpy is imported; workers inherit it.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
