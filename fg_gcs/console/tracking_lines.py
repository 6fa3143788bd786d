"""What a person sees of the tracking: where the target is, how the formation stands to it, what was seen of it."""

from __future__ import annotations

import math
from collections.abc import Mapping

from rich.table import Table
from rich.text import Text

from fg_gcs.flight.target_follower import TrackingStatus, said
from fg_gcs.track.estimate.group import GroupEstimate
from fg_gcs.track.follow.replanner import FollowMode

HEIGHT = 4  # lines of the picture that are kept for it, whether there is something to say or not
GROWN = 0.005  # a change of size that shows in the two digits behind the point


def tracking_lines(status: TrackingStatus | None) -> Table:
    """Return the lines about tracking, always `HEIGHT` of them; what does not fit the terminal is cut at its edge."""
    grid = Table.grid(padding=(0, 2, 0, 0))
    rows = [("target", Text("tracked in approach and hold", "dim"))] if status is None else _rows(status)
    for name, text in [*rows, *[("", Text())] * (HEIGHT - len(rows))]:
        text.no_wrap, text.overflow = True, "ellipsis"
        grid.add_row(Text(name, "dim"), text)
    return grid


def refused_text(refused: Mapping[str, int]) -> str:
    """Return how many were refused and why, most frequent first: ``10 gated, 2 too old``."""
    counts = sorted(refused.items(), key=lambda item: -item[1])
    return ", ".join(f"{count} {reason.replace('_', ' ')}" for reason, count in counts)


def _rows(status: TrackingStatus) -> list[tuple[str, Text]]:
    refused = refused_text({said(verdict): count for verdict, count in status.refused.items()})
    sightings = Text(f"{status.sightings}")
    if refused:
        sightings.append(f", refused: {refused}", "yellow")
    latency = "-" if math.isnan(status.latency_s) else f"{1e3 * status.latency_s:.0f} ms from stamp to setpoint"
    return [
        ("target" if status.targets == 1 else "targets", _target(status)),
        ("formation", _formation(status)),
        ("sightings", sightings),
        ("latency", Text(latency)),
    ]


def _target(status: TrackingStatus) -> Text:
    known = status.known
    if known is None:
        return Text(f"not seen yet, home in {status.patience_s:.0f} s", "yellow")
    if _all_lost(status, known):
        text = Text(f"LOST, seen {known.age_s:.1f} s ago, home in {status.patience_s:.0f} s", "bold red")
        return text.append(f", believed {_place(known)}", "default")
    text = Text("seen", "green").append(f" {known.age_s:.1f} s ago, {_motion(known)} {_place(known)}", "default")
    if known.lost or known.unseen:
        missing = [
            f"{', '.join(names)} {what}"
            for names, what in ((known.lost, "LOST"), (known.unseen, "not seen yet"))
            if names
        ]
        return Text(f"{'; '.join(missing)}; ", "bold red").append_text(text)
    return text


def _formation(status: TrackingStatus) -> Text:
    known, size = status.known, ""
    if abs(status.growth - 1.0) > GROWN:
        size = f", size x {status.growth:.2f}"
    if known is None or _all_lost(status, known):
        what = FollowMode.WAIT.value if known is None or status.rests else "going on as predicted"
        return Text(f"{what}{size}", "yellow")
    text = Text(f"{status.mode.value}, ", "cyan")
    text.append(f"{status.error_m:.1f} m off", "green" if status.caught else "yellow")
    return text.append(size if status.caught else f"{size}, home in {status.patience_s:.0f} s unless caught", "default")


def _all_lost(status: TrackingStatus, known: GroupEstimate) -> bool:
    return len(known.lost) + len(known.unseen) == status.targets


def _motion(known: GroupEstimate) -> str:
    return f"{math.hypot(*known.velocity_m_s.tolist()):.1f} m/s"


def _place(known: GroupEstimate) -> str:
    east, north, up = known.position_enu_m.tolist()
    sides = "E" if east >= 0.0 else "W", "N" if north >= 0.0 else "S"
    return f"at {abs(east):.0f} {sides[0]}, {abs(north):.0f} {sides[1]}, {up:.0f} m up"
