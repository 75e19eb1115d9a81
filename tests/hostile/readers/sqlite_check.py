"""sqlite3's integrity check, and counts by topic."""

# ruff: noqa: T201 - the answer goes to stdout

import json
import sqlite3
import sys
from pathlib import Path

if sys.argv[1] != "--there":
    path = Path(sys.argv[1])
    counts = {}
    for file in sorted(path.glob("*.db3")) if path.is_dir() else [path]:
        connection = sqlite3.connect(f"file:{file}?mode=ro", uri=True)
        (said,) = connection.execute("PRAGMA integrity_check").fetchone()
        if said != "ok":
            sys.exit(said)
        query = "SELECT name, count(*) FROM messages JOIN topics ON topics.id = topic_id GROUP BY name"
        counts.update(connection.execute(query))
        connection.close()
    print(json.dumps({"counts": counts}))
