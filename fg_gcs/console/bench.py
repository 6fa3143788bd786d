"""The commands ``bench``: each measures side by side in one run; a table for people, one JSON object for programs."""

from __future__ import annotations

import argparse
import asyncio
import json
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from fg_gcs.console.codes import ExitCode
from fg_gcs.console.experiment import show, tell
from fg_gcs.errors import MissionError
from fg_gcs.experiment.bench import PlanBench, bench_plan
from fg_gcs.experiment.memory_bench import memory_bench
from fg_gcs.experiment.record_bench import record_bench
from fg_gcs.experiment.required import Figure
from fg_gcs.experiment.sim_bench import SimBench, sim_bench
from fg_gcs.experiment.sim_bench import Size as SimSize
from fg_gcs.experiment.stream_bench import Size, StreamBench, stream_bench
from fg_gcs.experiment.streaming import MOST_IDS
from fg_gcs.experiment.tables import Column, ResultTable
from fg_gcs.experiment.track_bench import COLUMNS, TEXT, fly_once, measure
from fg_gcs.experiment.track_bench import Size as TrackSize
from fg_gcs.link.clock import make_loop
from fg_gcs.record.write.recorder import plain


def run(chosen: argparse.Namespace) -> ExitCode:
    """Run the chosen benchmark.

    Raises:
        PlanError: a scene, or a mission, has no plan.
        MissionError: a mission file is missing or wrong.
        FgError: a flight was not completed.
    """
    match chosen.what:
        case "track":
            figures = _track(chosen)
        case "stream":
            figures = _stream(chosen)
        case "sim":
            figures = _sim(chosen)
        case "record":
            figures = _memory(chosen.missions) if chosen.hour else _record()
        case _:
            figures = _plan()
    if chosen.json:
        print(json.dumps(plain(figures)), flush=True)
    return ExitCode.DONE


def _plan() -> dict[str, object]:
    figures = bench_plan(time.perf_counter, tell)
    print(_words(figures), file=sys.stderr)
    return asdict(figures)


def _track(chosen: argparse.Namespace) -> dict[str, object]:
    size = TrackSize(chosen.flights, chosen.seed, jobs=chosen.jobs)
    figures, rows = measure(chosen.missions, size, fly_once, time.perf_counter, tell)
    show(ResultTable("track", "Tracking", TEXT, COLUMNS, rows))
    return figures


def _record() -> dict[str, object]:
    made = record_bench(time.process_time)
    met = made.share <= made.budget
    columns = Column("figure"), Column("required"), Column("measured", 3), Column("met")
    rows = (
        ("share of a core [%]", f"<= {100.0 * made.budget:g}", 100.0 * made.share, "yes" if met else "NO"),
        ("frames of both directions [1/s]", None, made.frames_hz, None),
        ("written [kB/s]", None, 1e-3 * made.bytes_s, None),
    )
    text = f"A made-up flight of {made.vehicles} vehicles at full rates, {made.flight_s:g} s long."
    show(ResultTable("record", f"Recording {made.vehicles} vehicles at full rates", text, columns, rows))
    return made._asdict() | {"met": met}


def _stream(chosen: argparse.Namespace) -> dict[str, object]:
    size = Size(tuple(sorted(chosen.vehicles)), chosen.many, chosen.seconds / 5.0, chosen.seconds, not chosen.alone)
    with asyncio.Runner(loop_factory=lambda: make_loop(1.0)) as runner:
        made = runner.run(stream_bench(tell, size))
    _show_races(made)
    _show_streams(made)
    figures = made.figures()
    return {
        **made._asdict(),
        "setpoints": [row._asdict() | {"ratio": row.ratio} for row in made.setpoints],
        "streams": [each._asdict() for each in made.streams],
        "many": made.many._asdict(),
        "required": [figure._asdict() for figure in figures],
        "met": all(figure.met for figure in figures),
    }


def _show_races(made: StreamBench) -> None:
    columns = (
        *(Column("station"), Column("vehicles", 0), Column("setpoint [us]"), Column("bare sendto [us]")),
        *(Column("ratio"), Column("right", 0), Column("wrong", 0), Column("remark")),
    )
    rows = tuple(
        (row.station, row.vehicles, row.setpoint_us, row.bare_us, row.ratio, row.right, row.wrong, row.remark)
        for row in made.setpoints
    )
    text = "From array to socket, in turn with a bare loop of sendto; where the setpoints arrived."
    show(ResultTable("setpoints", "Setpoints", text, columns, rows))


def _show_streams(made: StreamBench) -> None:
    columns = (
        *(Column("vehicles", 0), Column("rate [Hz]", 0), Column("networks", 0), Column("telemetry [Hz]", 0)),
        *(Column("of a core [%]", 1), Column("late p99 [ms]"), Column("worst [ms]"), Column("left out", 0)),
        *(Column("memory [MB]", 0), Column("gate [us]", 2)),
    )
    rows = tuple(
        (
            *(each.vehicles, each.rate_hz, each.networks, each.position_hz, 100.0 * each.core),
            *(each.late_p99_ms, each.late_worst_ms, each.late_ticks, each.memory_mb, each.gate_us),
        )
        for each in (*made.streams, made.many)
    )
    show(ResultTable("streams", "Streams, recorded", "Setpoints in real time to bare vehicles.", columns, rows))
    _show_required(made.figures())


def _show_required(figures: Sequence[Figure]) -> None:
    columns = Column("figure"), Column("required"), Column("measured"), Column("met")
    rows = tuple((figure.name, figure.required, figure.measured, "yes" if figure.met else "NO") for figure in figures)
    show(ResultTable("required", "What is required", "", columns, rows))


def _sim(chosen: argparse.Namespace) -> dict[str, object]:
    if max(chosen.vehicles) > MOST_IDS:
        raise MissionError(f"--vehicles {max(chosen.vehicles)}; accepted: up to {MOST_IDS}")
    size = SimSize(
        counts=tuple(sorted(chosen.vehicles)),
        swarm=chosen.swarm,
        part_s=min(1.0, chosen.seconds),
        alone_s=chosen.seconds,
    )
    made = sim_bench(_text(chosen.missions / "circle.toml"), tell, size)
    _show_simulators(made)
    _show_flights(made)
    figures = made.figures()
    _show_required(figures)
    return {
        "physics": [row._asdict() for row in made.physics],
        "packing": [row._asdict() | {"ratio": row.ratio} for row in made.packing],
        "alone": [each._asdict() for each in made.alone],
        "virtual": made.virtual._asdict() | {"times_real": made.virtual.times_real},
        "real": None if made.real is None else made.real._asdict(),
        "required": [figure._asdict() for figure in figures],
        "met": all(figure.met for figure in figures),
    }


def _show_simulators(made: SimBench) -> None:
    show(
        ResultTable(
            "physics",
            "Physics alone",
            "One step a call, as the simulator does it.",
            (Column("dynamics"), Column("vehicles", 0), Column("vehicle-steps [million/s]")),
            tuple((row.dynamics, row.vehicles, 1e-6 * row.steps_s) for row in made.physics),
        )
    )
    show(
        ResultTable(
            "packing",
            "Telemetry alone",
            "From the vehicles' state to frames; pymavlink packs the same messages from numbers.",
            (Column("vehicles", 0), Column("message [us]"), Column("pymavlink [us]"), Column("ratio")),
            tuple((row.vehicles, row.message_us, row.pymavlink_us, row.ratio) for row in made.packing),
        )
    )
    alone = tuple(
        (
            *(each.vehicles, 100.0 * each.core, each.late_p99_ms, each.late_worst_ms, each.left_out),
            *(each.messages_s, each.message_us, each.memory_mb),
        )
        for each in made.alone
    )
    columns = (
        *(Column("vehicles", 0), Column("of a core [%]", 1), Column("late p99 [ms]"), Column("worst [ms]")),
        *(Column("left out", 0), Column("messages [1/s]", 0), Column("message, all in all [us]", 1)),
        Column("memory [MB]", 1),
    )
    text = "A process of its own in real time, with default telemetry to a sink that counts."
    show(ResultTable("alone", "The simulator alone", text, columns, alone))


def _show_flights(made: SimBench) -> None:
    flown, real = made.virtual, made.real
    show(
        ResultTable(
            "virtual",
            "A flight in virtual time",
            "Station and simulator on one core, seconds of the processor; imports and report are not counted.",
            (
                *(Column("vehicles", 0), Column("flight [s]", 1), Column("took [s]"), Column("times real", 1)),
                *(Column("imports [s]"), Column("report [s]")),
            ),
            (
                (
                    *(flown.vehicles, flown.flight_s, flown.cpu_s),
                    *(flown.times_real, flown.imports_s, flown.report_s),
                ),
            ),
        )
    )
    if real is None:
        return
    columns = (
        *(Column("vehicles", 0), Column("flight [s]", 1), Column("completed"), Column("error rms [m]", 3)),
        *(Column("worst [m]"), Column("setpoints [Hz]", 1), Column("late p99 [ms]"), Column("left out", 0)),
        *(Column("station [% of a core]", 1), Column("simulator [% of a core]", 1)),
    )
    cells = (
        *(real.vehicles, real.flight_s, "yes" if real.completed else "NO", real.error_rms_m, real.error_worst_m),
        *(real.setpoint_hz, real.late_p99_ms, real.left_out, 100.0 * real.station_core, 100.0 * real.simulator_core),
    )
    text = "Station and simulator as two processes on this machine; planning and evaluation included."
    show(ResultTable("real", "A large swarm in real time", text, columns, (cells,)))
    if real.reason:
        tell(f"the large swarm: {real.reason}")


def _text(path: Path) -> str:
    """Return what a mission file holds.

    Raises:
        MissionError: it cannot be read.
    """
    try:
        return path.read_text()
    except OSError as error:
        raise MissionError(f"{path}: {error.strerror or error}") from error


def _memory(missions: Path) -> dict[str, object]:
    path = missions / "circle.toml"
    text = _text(path)
    tell(f"flying {path} for an hour in virtual time; that takes some minutes ...")
    made = memory_bench(text)
    met = made.growth_mb <= made.budget_mb
    columns = Column("figure"), Column("required"), Column("measured", 1), Column("met")
    rows = (
        ("growth after the first minute [MB]", f"<= {made.budget_mb:g}", made.growth_mb, "yes" if met else "NO"),
        ("memory after the first minute [MB]", None, made.first_minute_mb, None),
        ("evaluation after the landing [MB]", None, made.evaluation_mb, None),
    )
    text = f"{made.vehicles} vehicles, {made.flight_s:g} s in virtual time; the simulator in the same process."
    show(ResultTable("memory", f"Memory of a flight of {made.vehicles} vehicles", text, columns, rows))
    return made._asdict() | {"met": met}


def _words(figures: PlanBench) -> str:
    lengths = ", ".join(f"({target}) {metres:.1f} m" for target, metres in figures.path_length_m.items())
    return "\n".join(
        (
            f"search       {figures.fg_time_ms_median:.2f} ms, {figures.fg_speedup_median:.0f} times as fast as the "
            f"paper's way (worst {figures.fg_speedup_worst:.0f})",
            f"whole plan   {figures.plan_time_ms_median:.2f} ms, {figures.plan_speedup_median:.0f} times as fast",
            f"flux metric  at least {figures.flux_metric_worst_rows:.5f} on the printed rows, "
            f"{figures.flux_metric_worst_draws:.5f} on random scenes",
            f"lengths      {lengths}",
            f"separation   at least {figures.separation_ratio_worst:.4f} of the formation's own",
            f"limits       speed {figures.speed_ratio_worst:.4f}, acceleration {figures.acceleration_ratio_worst:.4f} "
            "of the limit at most",
            f"duration     at most {figures.duration_ratio_worst:.4f} of the optimum; "
            f"to (40,40,40) {figures.flight_time_40_s:.2f} s",
            f"growth       64 leaders take {figures.leaders_64_ratio:.2f} times the time of 4; "
            f"1000 followers add {figures.followers_1000_ms:.1f} ms and {figures.memory_1000_mb:.0f} MB",
        )
    )
