"""What the paper publishes, by the targets that its figures belong to [Hartley2021]_."""

from __future__ import annotations

from fg_gcs.experiment.baselines.least_squares import FREE_SIZE, HELD_SIZE

FLUX_GUIDED = "FG"
LENGTHS_M = {  # of the four leaders together; printed beside targets of 40 m, computed with these
    (50.0, 50.0, 50.0): {FREE_SIZE.name: 455.0, HELD_SIZE.name: 346.0, FLUX_GUIDED: 345.0},
    (-50.0, 50.0, 50.0): {FREE_SIZE.name: 500.0, HELD_SIZE.name: 543.0, FLUX_GUIDED: 354.0},
}
PLAN_TIMES_S = {(10.0, 10.0, 10.0): 0.52, (-10.0, 10.0, 10.0): 0.88}  # nine vehicles, timing included
DRAWN_METRIC = (0.99, 0.03)  # mean and standard deviation over the paper's 100 draws
DRAWN_TIME_S = (1.23, 1.16)
