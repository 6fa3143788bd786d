"""The tables of the physics: one row a vehicle, named columns, SI units, world NED.

Kernels read and write the rows; everybody else uses columns, which are views (`table["position_m"]` has shape (V, 3)).
"""

from __future__ import annotations

import numpy as np

VECTOR = (np.float64, (3,))

STATE = np.dtype(
    [
        # What is true
        ("position_m", *VECTOR),
        ("velocity_m_s", *VECTOR),
        ("acceleration_m_s2", *VECTOR),  # all of it, held during the last step
        ("yaw_rad", np.float64),
        ("yaw_rate_rad_s", np.float64),
        ("in_contact", np.bool_),
        ("impact_m_s", np.float64),  # speed at which the ground was touched last
        # What the autopilot believes, and what makes the difference
        ("estimated_position_m", *VECTOR),
        ("estimated_velocity_m_s", *VECTOR),
        ("error_m", *VECTOR),  # estimate minus truth, all causes
        ("error_m_s", *VECTOR),
        ("wander_m", *VECTOR),  # slow errors of the estimator (Gauss-Markov)
        ("wander_m_s", *VECTOR),
        ("drift_m", *VECTOR),  # gathered without GPS
        ("drift_m_s", *VECTOR),
        # The airframe
        ("thrust_m_s2", np.float64),  # collective, per mass
        ("lean", np.float64, (2,)),  # north and east of the unit vector along the thrust
        ("lean_per_s", np.float64, (2,)),
        ("upward", *VECTOR),  # along the thrust, any length
        ("gust_m_s", *VECTOR),
        # What the control law aims at, and remembers
        ("target_m", *VECTOR),
        ("target_m_s", *VECTOR),
        ("target_m_s2", *VECTOR),
        ("asked_m_s2", *VECTOR),  # acceleration that the law asks for
        ("correction_m_s2", *VECTOR),
        ("integral_m_s2", *VECTOR),
        ("desired_m", *VECTOR),  # the shaped target
        ("desired_m_s", *VECTOR),
        ("desired_m_s2", *VECTOR),
        ("miss_m_s", *VECTOR),  # filtered error of velocity
        ("miss_m_s2", *VECTOR),  # filtered derivative of it, or of the velocity
        ("last_m_s", *VECTOR),  # estimated velocity of the last step
        ("level_kind", np.int64),  # which horizontal quantities were controlled in the last step
        ("vertical_kind", np.int64),
        ("random_state", np.uint64),
    ],
    align=True,
)

COMMAND = np.dtype(
    [
        ("position_m", *VECTOR),
        ("velocity_m_s", *VECTOR),
        ("acceleration_m_s2", *VECTOR),
        ("position_used", *VECTOR),  # 0 or 1: multiplied, not branched on
        ("velocity_given", *VECTOR),  # 0 or 1
        ("controlled", *VECTOR),  # 0 or 1: position or velocity is controlled
        ("position_gain_per_s", np.float64),
        ("speed_headroom_m_s", np.float64),
        ("yaw_rad", np.float64),
        ("yaw_rate_rad_s", np.float64),
        ("yaw_used", np.bool_),
        ("since_s", np.float64),
        ("carry_s", np.float64),
        ("lapses", np.bool_),
        ("planned", np.float64),  # 1: the autopilot's own target, which it approaches within acceleration and jerk
        ("speed_m_s", np.float64),
        ("climb_m_s", np.float64),
        ("descent_m_s", np.float64),
        ("correction_m_s2", np.float64),
        ("flying", np.bool_),
    ],
    align=True,
)

DISTURBANCE = np.dtype(
    [
        ("estimate_offset_m", *VECTOR),  # added to the estimated position
        ("estimate_noise_m", np.float64),  # standard deviation of further white noise on each axis of it
        ("estimate_frozen", np.bool_),  # estimated position and velocity stand still
        ("gps_lost", np.bool_),  # dead reckoning: the horizontal estimate drifts away
        ("wind_m_s", *VECTOR),  # mean
        ("gust_m_s", np.float64),  # standard deviation of gusts on each axis
        ("thrust_share", np.float64),  # 1: healthy; less: of the greatest thrust; 0: a motor is dead, it falls
    ],
    align=True,
)

# Numbers of one vehicle's airframe, estimator and control law: `flight_model` says where they come from.
MODEL = np.dtype(
    [
        # Airframe
        ("gravity_m_s2", np.float64),
        ("drag_per_s", np.float64),
        ("drag_per_m", np.float64),  # times speed squared
        ("thrust_most_m_s2", np.float64),
        ("thrust_time_s", np.float64),  # first-order lag of the motors
        ("fall_lift_share", np.float64),  # of the weight that a vehicle with a dead motor still lifts
        ("attitude_gain_per_s", np.float64),
        ("attitude_rate_most_rad_s", np.float64),
        ("attitude_rate_time_s", np.float64),
        ("yaw_gain_per_s", np.float64),
        ("yaw_rate_most_rad_s", np.float64),
        ("yaw_acceleration_most_rad_s2", np.float64),
        # Estimator
        ("wander_sigma_m", *VECTOR),
        ("wander_time_s", *VECTOR),
        ("wander_sigma_m_s", *VECTOR),
        ("wander_velocity_time_s", np.float64),
        ("wander_share", np.float64),  # of the velocity's error that the position's error gathers
        ("drift_m_s2", np.float64, (2,)),  # uncorrected acceleration, north and east
        ("drift_noise_m_s2", np.float64),  # per root of hertz
        ("recovery_time_s", np.float64),  # in which GPS takes a drift back
        # Control law
        ("carries", np.bool_),  # whether a target runs on between messages
        ("position_gain_level_per_s", np.float64),
        ("position_gain_vertical_per_s", np.float64),
        ("velocity_p_level_per_s", np.float64),
        ("velocity_i_level_per_s2", np.float64),
        ("velocity_d_level", np.float64),
        ("velocity_p_vertical_per_s", np.float64),
        ("velocity_i_vertical_per_s2", np.float64),
        ("velocity_d_vertical", np.float64),
        ("integral_most_m_s2", np.float64),
        ("error_cutoff_hz", np.float64),
        ("derivative_cutoff_hz", np.float64),
        ("tilt_most_rad", np.float64),
        ("thrust_least_share", np.float64),
        ("thrust_margin_share", np.float64),  # of the thrust kept for horizontal control
        ("jerk_level_m_s3", np.float64),
        ("jerk_vertical_m_s3", np.float64),
        ("acceleration_vertical_m_s2", np.float64),
        ("acceleration_p", np.float64),
        ("acceleration_i_per_s", np.float64),
    ],
    align=True,
)

# Numbers of the particle's inner loop and of the world, the same for all vehicles.
WORLD = np.dtype(
    [
        (name, np.float64)
        for name in (
            "body_speed_m_s",
            "body_acceleration_m_s2",
            "velocity_gain_per_s",
            "integral_gain_per_s2",
            "integral_bound_m_s2",
            "smoothing_s",
            "headroom",
            "braking_share",
            "stiffness_per_s2",
            "damping_per_s",
            "friction_per_s",
            "contact_m",
            "wind_drag_per_s",
            "gust_time_s",
        )
    ],
    align=True,
)
