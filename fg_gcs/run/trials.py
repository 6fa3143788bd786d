"""Random trials, each a pure function of its seed: a mission, an autopilot, and what goes wrong."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from fg_gcs.mission.model import Mission
from fg_gcs.run.harms import Death, Stall, Stranger, StrangerKind
from fg_gcs.run.trial import Trial

Table = dict[str, Any]
Draw = np.random.Generator

STAGES: Final = ("take-off", "gather", "approach", "hold", "home", "land")
LASTS_S: Final = (2.0, 4.0, 6.0, np.inf)
MODES: Final = MappingProxyType({"px4": ("LAND", "LOITER", "RTL"), "ardupilot": ("LAND", "LOITER", "RTL")})
TASKS: Final = (
    "streamer",
    "watch",
    "descents",
    "recorder",
    "heartbeat",
    "parameters",
    "compensation",
)  # of every flight
STANDS_S: Final = (1.0, 5.0)  # that a station stands still
MOST_AFTER_S: Final = 4.0  # after a stage has begun something goes wrong
AFTER_EACH_OTHER_S: Final = 1.0  # two things that go wrong


def trial_of(
    seed: int,
    missions: Sequence[Mission],
    autopilots: Sequence[str],
    dynamics: Sequence[str],
    faults_each: int | None = None,
) -> Trial:
    """Return the trial of a seed.

    Args:
        seed: 0 or more.
        missions: of which one is flown.
        autopilots: of which the simulator plays one.
        dynamics: of which vehicles fly by one.
        faults_each: how many things go wrong; None: one or two.
    """
    draw = np.random.default_rng([seed, 0x7A1A1])
    mission = missions[int(draw.integers(len(missions)))]
    autopilot = autopilots[int(draw.integers(len(autopilots)))]
    chosen = dynamics[int(draw.integers(len(dynamics)))]
    stage = STAGES[int(draw.integers(len(STAGES)))]
    at_s = float(np.round(draw.uniform(0.0, MOST_AFTER_S), 2))
    making = _Making(draw, mission, autopilot, stage, at_s)
    for _ in range(1 + int(draw.integers(2)) if faults_each is None else faults_each):
        kind = list(WRONGS)[int(draw.integers(len(WRONGS)))]
        WRONGS[kind](making)
        making.at_s = float(np.round(making.at_s + draw.uniform(0.0, AFTER_EACH_OTHER_S), 2))
    if faults_each == 0:  # nothing but the world itself differs
        simulator = mission.simulator.model_copy(update={"seed": seed})
        mission = mission.model_copy(update={"simulator": simulator})
    return Trial(mission, autopilot, chosen, **making.made())


class _Making:
    """A trial that is being made."""

    def __init__(self, draw: Draw, mission: Mission, autopilot: str, stage: str, at_s: float) -> None:
        self.draw, self.autopilot, self.stage, self.at_s = draw, autopilot, stage, at_s
        self.faults: list[Table] = []
        self.impairments: list[Table] = []
        self.stops: list[tuple[str, float]] = []
        self.disk_full: list[tuple[str, float]] = []
        self.deaths: list[Death] = []
        self.stalls: list[Stall] = []
        self.strangers: list[Stranger] = []
        self.tasks = TASKS if mission.targets is None else (*TASKS, "planner")
        self._ids = mission.swarm.ids()

    def made(self) -> dict[str, Any]:
        """What was made, by the names of a `Trial`."""
        names = ("faults", "impairments", "stops", "disk_full", "deaths", "stalls", "strangers")
        return {name: tuple(getattr(self, name)) for name in names}

    def window(self, most: int = 2) -> Table:
        """Some vehicles, from the time on."""
        count = int(self.draw.integers(1, most + 1))
        chosen = sorted(self.draw.choice(self._ids, count, replace=False).tolist())
        return {"vehicles": chosen, "stage": self.stage, "at_s": self.at_s}

    def lasting(self) -> Table:
        """How long, or for good."""
        lasts_s = LASTS_S[int(self.draw.integers(len(LASTS_S)))]
        return {} if np.isinf(lasts_s) else {"for_s": lasts_s}


def _muted(direction: str) -> Callable[[_Making], None]:
    def make(it: _Making) -> None:
        it.impairments.append({"direction": direction, "loss": 1.0, **it.window(), **it.lasting()})

    return make


def _poor_link(it: _Making) -> None:
    loss = float(np.round(it.draw.uniform(0.01, 0.2), 2))
    it.impairments.append({"loss": loss})


def _late_link(it: _Making) -> None:
    it.impairments.append({"delay_s": 0.1, "jitter_s": 0.1, "reorder": 0.1, "duplicate": 0.1})


def _taken(it: _Making) -> None:
    modes = MODES[it.autopilot]
    it.faults.append({"kind": "taken_over", "mode": modes[int(it.draw.integers(len(modes)))], **it.window(1)})


def _dead(it: _Making) -> None:
    it.faults.append({"kind": "dead", **it.window(1)})


def _battery(it: _Making) -> None:
    it.faults.append({"kind": "battery_low", "remaining": 0.12, **it.window(1)})


def _rebooted(it: _Making) -> None:
    it.faults.append({"kind": "reboot", **it.window(1)})


def _origin(it: _Making) -> None:
    offset = np.round(it.draw.uniform(-8.0, 8.0, 3) * (1.0, 1.0, 0.25), 1).tolist()
    it.faults.append({"kind": "origin", "offset_enu_m": offset, "told": bool(it.draw.integers(2)), **it.window(1)})


def _disk(it: _Making) -> None:
    it.disk_full.append((it.stage, it.at_s))


def _stop(it: _Making) -> None:
    it.stops.append((it.stage, it.at_s))


def _death(it: _Making) -> None:
    task = it.tasks[int(it.draw.integers(len(it.tasks)))]
    it.deaths.append(Death(task, bool(it.draw.integers(2)), it.stage, it.at_s))


def _stall(it: _Making) -> None:
    lasts_s = float(np.round(it.draw.uniform(*STANDS_S), 1))
    it.stalls.append(Stall(lasts_s, it.stage, it.at_s))


def _stranger(it: _Making) -> None:
    kinds: tuple[StrangerKind, ...] = ("station", "twin")
    (system_id,) = it.window(1)["vehicles"]
    it.strangers.append(Stranger(kinds[int(it.draw.integers(2))], system_id, it.stage, it.at_s))


WRONGS: Final[Mapping[str, Callable[[_Making], None]]] = MappingProxyType(
    {
        "telemetry muted": _muted("from_vehicle"),
        "commands muted": _muted("to_vehicle"),
        "both muted": _muted("both"),
        "a poor link": _poor_link,
        "a late link": _late_link,
        "taken over": _taken,
        "dead": _dead,
        "rebooted": _rebooted,
        "a local frame that moves": _origin,
        "a low battery": _battery,
        "a stop": _stop,
        "a full disk": _disk,
        "a task that dies": _death,
        "a station that stands still": _stall,
        "a stranger": _stranger,
    }
)
