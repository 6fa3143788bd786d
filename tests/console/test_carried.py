"""A run is all in its folder: carried elsewhere, and what it was made from deleted, it gives the same report."""

from __future__ import annotations

import shutil
from pathlib import Path

from fg_gcs.console.cli import main
from tests.flight.harness import moving

RECORDED = '[[targets]]\nname = "car"\n[targets.motion]\nkind = "file"\npath = "inputs/way.csv"\n'
WAY = "time_s,target,east_m,north_m,up_m\n0,car,12,0,12\n60,car,-12,10,12\n120,car,12,20,12\n"


def test_a_run_carried_elsewhere_without_its_inputs_gives_the_same_report(tmp_path: Path) -> None:
    made = tmp_path / "made"
    (made / "inputs").mkdir(parents=True)
    (made / "inputs" / "way.csv").write_text(WAY)
    (made / "car.toml").write_text(moving(RECORDED))
    assert main(["fly", str(made / "car.toml"), "--speed", "max", "--logs", str(made / "logs")]) == 0
    (folder,) = (made / "logs").iterdir()
    written = (folder / "report.html").read_bytes()
    carried = tmp_path / "far" / "away" / "another-name"
    shutil.copytree(folder, carried)
    shutil.rmtree(made)
    (carried / "report.html").unlink()
    assert main(["report", str(carried)]) == 0
    assert (carried / "report.html").read_bytes() == written
    assert b"Time until the target was caught" in written
