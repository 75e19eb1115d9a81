"""Run the tutorial and draw its pictures again: `python docs/make_tutorial.py`, in a copy of the repository.

The picture of the report needs chromium; without it, that one stays as it is.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "tutorial.md"
IMAGES = ROOT / "docs" / "images"


def sessions() -> list[tuple[str, list[str]]]:
    """Return the tutorial's commands in order, each with the lines of its answer that the page shows."""
    found: list[tuple[str, list[str]]] = []
    for block in re.findall(r"```console\n(.*?)```", PAGE.read_text(encoding="utf8"), re.DOTALL):
        for line in block.splitlines():
            if line.startswith("$ "):
                found.append((line[2:], []))
            elif line.strip():
                found[-1][1].append(line)
    return found


def play(command: str, folder: Path) -> str:
    """Return all that a command says; `odomcorrupt` is the one of this Python."""
    tools = folder / ".tools"
    if not tools.exists():
        tools.mkdir()
        script = tools / "odomcorrupt"
        script.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m odomcorrupt "$@"\n')
        script.chmod(0o755)
        (folder / "fixtures").symlink_to(ROOT / "fixtures")
    paths = {"PATH": f"{tools}{os.pathsep}{os.environ['PATH']}", "PYTHONPATH": str(ROOT)}
    done = subprocess.run(  # noqa: S603 - the page is ours
        ["/bin/bash", "-c", command], cwd=folder, env=os.environ | paths, text=True, check=False,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    )  # fmt: skip
    if done.returncode:
        raise SystemExit(f"$ {command}\n{done.stdout}")
    return done.stdout


def main() -> None:
    """Play all of it, and keep the pictures."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for command, _ in sessions():
            print(f"$ {command}\n{play(command, folder)}")
        for picture in ("rejected", "falls", "fan"):
            shutil.copyfile(folder / f"{picture}.png", IMAGES / f"tutorial_{picture}.png")
        chromium = shutil.which("chromium")
        if chromium:
            target = folder / "report.png"
            subprocess.run(  # noqa: S603 - as above
                [chromium, "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars",
                 "--window-size=1150,1240", f"--screenshot={target}", (folder / "missing.html").as_uri()],
                check=True, capture_output=True,
            )  # fmt: skip
            shutil.copyfile(target, IMAGES / "tutorial_report.png")


if __name__ == "__main__":
    main()
