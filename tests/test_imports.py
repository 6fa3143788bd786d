"""What only experiments and plots need is installed for all, and loaded by them alone."""

from __future__ import annotations

import subprocess
import sys

SPARED = ("toppra", "matplotlib")
FLYING = """
import importlib, pkgutil, sys
import fg_gcs

rooms = ("core", "plan", "track", "scenario", "mission", "wire", "link", "flight", "record.write", "record.evaluate")
for room in rooms:
    package = importlib.import_module(f"fg_gcs.{room}")
    for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        importlib.import_module(module.name)
importlib.import_module("fg_gcs.console.fly")
importlib.import_module("sitl_mock.__main__")
print(*sorted({name.partition(".")[0] for name in sys.modules}))
"""


def test_flying_loads_no_library_of_experiments_and_plots() -> None:
    ran = subprocess.run([sys.executable, "-c", FLYING], capture_output=True, text=True, check=True)
    loaded = ran.stdout.split()
    assert {"fg_gcs", "sitl_mock", "numba", "pymavlink"} <= set(loaded)
    assert not set(SPARED) & set(loaded)
