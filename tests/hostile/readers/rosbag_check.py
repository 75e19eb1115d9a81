"""`rosbag check`: nothing to migrate."""

# ruff: noqa: T201 - the answer goes to stdout

import json
import subprocess
import sys

if sys.argv[1] == "--there":
    sys.exit(subprocess.run(["/usr/bin/rosbag", "help"], capture_output=True, check=False).returncode)
done = subprocess.run(["/usr/bin/rosbag", "check", sys.argv[1]], capture_output=True, check=False)
if done.returncode or b"does not need any migrations" not in done.stdout + done.stderr:
    sys.exit((done.stdout + done.stderr).decode() or "no answer")
print(json.dumps({}))
