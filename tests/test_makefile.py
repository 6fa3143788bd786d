"""What the Makefile does on a fresh machine runs: nobody else would notice before a stranger does."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
MAKEFILE = (ROOT / "Makefile").read_text()


def test_the_scripts_in_it_run() -> None:
    scripts = [found.replace("\\\n", "") for found in re.findall(r"\$\(BIN\)/python -c '([^']*)'", MAKEFILE)]
    assert scripts
    for script in scripts:
        subprocess.run([sys.executable, "-W", "error", "-c", script], cwd=ROOT, check=True)


def test_whatever_it_installs_has_a_version_in_the_constraints() -> None:
    wanted = re.findall(r'^    "([A-Za-z0-9-]+)>=', (ROOT / "pyproject.toml").read_text(), re.MULTILINE)
    fixed = {line.partition("==")[0].lower() for line in (ROOT / "constraints.txt").read_text().splitlines()}
    assert len(wanted) > 15
    assert {name.lower() for name in wanted} <= fixed
