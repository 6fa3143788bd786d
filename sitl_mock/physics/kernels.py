"""The physics step as machine code: every vehicle through a number of steps, one after the other.

Rows of the tables in `records`: `s` state, `c` command, `d` disturbance, `m` model, `k` world. World NED, SI units. A
vehicle's step: control law (by the estimate), airframe, ground, motion, heading, estimator. Vehicles do not touch each
other, and each has random numbers of its own, so that neither their number nor their order matters.
"""

from __future__ import annotations

import math

import numpy as np

from sitl_mock.physics.compiling import Row, kernel, part

TINY = 1e-9  # keeps 0/0 out of unit vectors; far below any length or speed that matters
SHAPED = 1  # control law, in the order of `flight_model.LAWS`
POSITION, VELOCITY = 1, 2  # bits of what is controlled
STRIDE, MIX_1, MIX_2 = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
SHIFT_1, SHIFT_2, SHIFT_3, SHIFT_4 = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(11)


@part
def _uniform(s: Row) -> float:
    """Next number in (0, 1) of a vehicle: splitmix64 (Steele, Lea and Flood 2014)."""
    s.random_state = s.random_state + STRIDE
    mixed = s.random_state
    mixed = (mixed ^ (mixed >> SHIFT_1)) * MIX_1
    mixed = (mixed ^ (mixed >> SHIFT_2)) * MIX_2
    mixed = mixed ^ (mixed >> SHIFT_3)
    return (float(mixed >> SHIFT_4) + 0.5) * 2.0**-53


@part
def _normals(s: Row) -> tuple[float, float]:
    """Next two standard normal numbers of a vehicle (Box and Muller 1958)."""
    radius = math.sqrt(-2.0 * math.log(_uniform(s)))
    angle = 2.0 * math.pi * _uniform(s)
    return radius * math.cos(angle), radius * math.sin(angle)


@part
def _add_noise(s: Row, vector: Row, sigma: float) -> None:
    """Add independent normal numbers to the axes of a vector."""
    first, second = _normals(s)
    third, _ = _normals(s)
    vector[0] += sigma * first
    vector[1] += sigma * second
    vector[2] += sigma * third


@part
def _length(vector: Row) -> float:
    return math.sqrt(vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2])


@part
def _shorten(vector: Row, longest: float) -> None:
    """Scale a vector down to at most `longest`."""
    scale = min(1.0, longest / max(_length(vector), TINY))
    for a in range(3):
        vector[a] *= scale


@part
def _clipped(value: float, least: float, most: float) -> float:
    return min(max(value, least), most)


@part
def _aim(s: Row, c: Row, time_s: float, carries: bool) -> bool:
    """Where the target is now, into `s.target_...`; whether its stream stopped, so that it stands where it ran to."""
    age_s = max(time_s - c.since_s, 0.0)
    run_s = min(age_s, c.carry_s) if carries else 0.0
    over: bool = c.lapses and age_s > c.carry_s
    live = 0.0 if over else 1.0
    for a in range(3):
        s.target_m[a] = c.position_m[a] + c.velocity_m_s[a] * run_s + c.acceleration_m_s2[a] * (0.5 * run_s * run_s)
        s.target_m_s[a] = (c.velocity_m_s[a] + c.acceleration_m_s2[a] * run_s) * live
        s.target_m_s2[a] = c.acceleration_m_s2[a] * live
    return over


@part
def _approach(c: Row, k: Row, distance_m: float) -> float:
    """Speed per distance towards a target: proportional when near, braking at constant deceleration when far."""
    gain: float = c.position_gain_per_s
    brake_m_s2 = k.braking_share * c.correction_m_s2
    near_m = brake_m_s2 / (gain * gain)
    if distance_m < near_m:
        return gain
    return math.sqrt(2.0 * brake_m_s2 * max(distance_m - 0.5 * near_m, 0.0)) / max(distance_m, TINY)


@part
def _limit_speed(s: Row, c: Row) -> None:
    """The wanted velocity within the limits; where it was cut, no feed-forward pushes outwards."""
    wanted, feed = s.target_m_s, s.target_m_s2
    allowed_m_s = c.speed_m_s + c.speed_headroom_m_s
    if math.hypot(wanted[0], wanted[1]) > allowed_m_s:
        if feed[0] * wanted[0] + feed[1] * wanted[1] > 0.0:
            feed[0] = feed[1] = 0.0
        _shorten_level(wanted, allowed_m_s)
    vertical_m_s = _clipped(wanted[2], -(c.climb_m_s + c.speed_headroom_m_s), c.descent_m_s + c.speed_headroom_m_s)
    if vertical_m_s != wanted[2]:
        if feed[2] * wanted[2] > 0.0:
            feed[2] = 0.0
        wanted[2] = vertical_m_s


@part
def _particle_law(s: Row, c: Row, d: Row, k: Row, time_s: float, dt_s: float) -> None:
    """Acceleration that a particle's autopilot asks for: feed-forward plus bounded, smoothed PID correction."""
    over = _aim(s, c, time_s, True)
    error_m = s.last_m_s  # scratch here: this law needs no last velocity
    for a in range(3):
        error_m[a] = (s.target_m[a] - s.estimated_position_m[a]) * c.position_used[a]
    level = _approach(c, k, math.hypot(error_m[0], error_m[1]))
    s.target_m_s[0] += error_m[0] * level
    s.target_m_s[1] += error_m[1] * level
    s.target_m_s[2] += error_m[2] * _approach(c, k, abs(error_m[2]))
    _limit_speed(s, c)
    asked, miss = s.asked_m_s2, s.miss_m_s
    for a in range(3):
        controlled = 1.0 if over else c.controlled[a]
        miss[a] = (s.target_m_s[a] - s.estimated_velocity_m_s[a]) * controlled
        asked[a] = k.velocity_gain_per_s * miss[a]
    _shorten(asked, c.correction_m_s2)
    flying = 1.0 if c.flying else 0.0
    share = dt_s / k.smoothing_s
    for a in range(3):
        s.correction_m_s2[a] += (asked[a] - s.correction_m_s2[a]) * share
        s.correction_m_s2[a] *= flying
        asked[a] = s.target_m_s2[a] + s.correction_m_s2[a]
    # Corrections may turn a fed-forward acceleration but hardly lengthen it: a plan at its limit stays there.
    _shorten(asked, max((1.0 + k.headroom) * _length(s.target_m_s2), c.correction_m_s2))
    if d.gust_m_s > 0.0 or _length(d.wind_m_s) > 0.0 or _length(s.integral_m_s2) > 0.0:
        # The integral of the velocity's error only has to answer wind: in still air it is left out.
        for a in range(3):
            # A saturated loop is on its way: nothing to learn from.
            if k.velocity_gain_per_s * abs(miss[a]) < c.correction_m_s2:
                s.integral_m_s2[a] += miss[a] * (k.integral_gain_per_s2 * dt_s)
            s.integral_m_s2[a] *= flying
        _shorten(s.integral_m_s2, k.integral_bound_m_s2)
        for a in range(3):
            asked[a] += s.integral_m_s2[a]
    _shorten(asked, k.body_acceleration_m_s2)


@part
def _particle(s: Row, c: Row, d: Row, m: Row, k: Row, time_s: float, dt_s: float) -> None:
    """The acceleration of a particle in the air: what was asked for, as far as its motors can, and wind."""
    _particle_law(s, c, d, k, time_s, dt_s)
    u = s.acceleration_m_s2
    for a in range(3):
        u[a] = s.asked_m_s2[a]
    if not c.flying:
        u[0], u[1], u[2] = 0.0, 0.0, m.gravity_m_s2
    elif d.thrust_share < 1.0:
        u[2] -= m.gravity_m_s2
        _shorten(u, d.thrust_share * (m.gravity_m_s2 + k.body_acceleration_m_s2))
        u[2] += m.gravity_m_s2
    s.upward[0], s.upward[1], s.upward[2] = u[0], u[1], u[2] - m.gravity_m_s2
    if c.flying and s.position_m[2] <= -k.contact_m:
        for a in range(3):
            u[a] += k.wind_drag_per_s * (d.wind_m_s[a] + s.gust_m_s[a])


@part
def _shorten_level(vector: Row, longest: float) -> None:
    """Scale the horizontal part of a vector down to at most `longest`."""
    scale = min(1.0, longest / max(math.hypot(vector[0], vector[1]), TINY))
    vector[0] *= scale
    vector[1] *= scale


@part
def _airframe(s: Row, c: Row, d: Row, m: Row, dt_s: float) -> None:
    """Acceleration of a multicopter whose law asks for the force per mass `s.asked_m_s2`: thrust, attitude and drag."""
    force, u = s.asked_m_s2, s.acceleration_m_s2
    wish = _length(force)
    if c.flying and d.thrust_share > 0.0:
        for a in range(2):
            rate = m.attitude_gain_per_s * (force[a] / max(wish, TINY) - s.lean[a])
            rate = _clipped(rate, -m.attitude_rate_most_rad_s, m.attitude_rate_most_rad_s)
            s.lean_per_s[a] += (rate - s.lean_per_s[a]) * min(1.0, dt_s / m.attitude_rate_time_s)
            s.lean[a] += s.lean_per_s[a] * dt_s
        given = d.thrust_share * min(wish, m.thrust_most_m_s2)
        s.thrust_m_s2 += (given - s.thrust_m_s2) * min(1.0, dt_s / m.thrust_time_s)
    else:
        s.lean[0] = s.lean[1] = s.lean_per_s[0] = s.lean_per_s[1] = 0.0
        s.thrust_m_s2 = m.fall_lift_share * m.gravity_m_s2 if c.flying else 0.0
    leaning = min(math.hypot(s.lean[0], s.lean[1]), 1.0)
    s.upward[0], s.upward[1], s.upward[2] = s.lean[0], s.lean[1], -math.sqrt(1.0 - leaning * leaning)
    speed_m_s = 0.0
    for a in range(3):
        u[a] = s.velocity_m_s[a] - d.wind_m_s[a] - s.gust_m_s[a]
        speed_m_s += u[a] * u[a]
    drag_per_s = m.drag_per_s + m.drag_per_m * math.sqrt(speed_m_s)
    for a in range(3):
        u[a] = s.thrust_m_s2 * s.upward[a] - drag_per_s * u[a]
    u[2] += m.gravity_m_s2


@part
def _limit_level(s: Row, ax: float, ay: float, most_m_s: float) -> None:
    """Horizontal velocity of at most `most_m_s`: the approach (ax, ay) goes before the fed-forward velocity."""
    fx, fy = s.target_m_s[0], s.target_m_s[1]
    approach, fed = math.hypot(ax, ay), math.hypot(fx, fy)
    share = 1.0
    if math.hypot(ax + fx, ay + fy) > most_m_s:
        if approach >= most_m_s or fed < TINY:
            scale = most_m_s / max(approach, TINY)
            ax, ay, share = ax * scale, ay * scale, 0.0
        else:  # |a + share f| = most, the positive root
            along = ax * fx + ay * fy
            inside = along * along - fed * fed * (approach * approach - most_m_s * most_m_s)
            share = (math.sqrt(max(inside, 0.0)) - along) / (fed * fed)
    s.target_m_s[0], s.target_m_s[1] = ax + share * fx, ay + share * fy


@part
def _direct_law(s: Row, c: Row, m: Row, time_s: float, dt_s: float, resting: bool) -> None:
    """P on position, PID on velocity with feed-forward of both, thrust vector: PX4's PositionControl.

    `_positionControl`, `_velocityControl` and `_accelerationControl` with MPC_ACC_DECOUPLE 1, and the anti-windup of
    both: vertically the integrator stops at the limits, horizontally it is driven back (Rundqwist 1990).
    """
    _plan(s, c, m, _aim(s, c, time_s, m.carries), resting, dt_s)
    gain = m.position_gain_level_per_s
    ax = gain * (s.target_m[0] - s.estimated_position_m[0]) * max(c.position_used[0], c.planned)
    ay = gain * (s.target_m[1] - s.estimated_position_m[1]) * max(c.position_used[1], c.planned)
    _limit_level(s, ax, ay, c.speed_m_s)
    gain = m.position_gain_vertical_per_s
    az = gain * (s.target_m[2] - s.estimated_position_m[2]) * max(c.position_used[2], c.planned)
    s.target_m_s[2] = _clipped(s.target_m_s[2] + az, -c.climb_m_s, c.descent_m_s)
    blend = dt_s / (dt_s + 1.0 / (2.0 * math.pi * m.derivative_cutoff_hz))
    force, miss = s.asked_m_s2, s.miss_m_s
    for a in range(3):
        p = m.velocity_p_level_per_s if a < 2 else m.velocity_p_vertical_per_s
        damping = m.velocity_d_level if a < 2 else m.velocity_d_vertical
        derivative = (s.estimated_velocity_m_s[a] - s.last_m_s[a]) / dt_s
        s.miss_m_s2[a] += (derivative - s.miss_m_s2[a]) * blend
        s.last_m_s[a] = s.estimated_velocity_m_s[a]
        miss[a] = (s.target_m_s[a] - s.estimated_velocity_m_s[a]) * c.controlled[a]
        if c.controlled[a] == 0.0 or resting:
            s.integral_m_s2[a] = 0.0
        force[a] = s.target_m_s2[a]
        force[a] += (p * miss[a] + s.integral_m_s2[a] - damping * s.miss_m_s2[a]) * c.controlled[a]
    if resting:  # so that no thrust is left
        force[0], force[1], force[2] = 0.0, 0.0, 100.0
    x_m_s2, y_m_s2 = force[0], force[1]
    least, most = m.thrust_least_share * m.thrust_most_m_s2, m.thrust_most_m_s2
    lift = max(m.gravity_m_s2 - force[2], TINY)
    force[2] = -m.gravity_m_s2
    _shorten_level(force, m.gravity_m_s2 * math.tan(m.tilt_most_rad))
    scale = max(lift, least * m.gravity_m_s2 / max(_length(force), TINY)) / m.gravity_m_s2
    for a in range(3):
        force[a] *= scale
    if (force[2] >= -least and miss[2] >= 0.0) or (force[2] <= -most and miss[2] <= 0.0):
        miss[2] = 0.0
    # Height first, but for a margin of thrust that stays horizontal.
    level = math.hypot(force[0], force[1])
    margin = min(level, m.thrust_margin_share * most)
    force[2] = max(force[2], -math.sqrt(most * most - margin * margin))
    _shorten_level(force, math.sqrt(max(most * most - force[2] * force[2], 0.0)))
    if x_m_s2 * x_m_s2 + y_m_s2 * y_m_s2 > force[0] * force[0] + force[1] * force[1]:
        miss[0] -= 2.0 / m.velocity_p_level_per_s * (x_m_s2 - force[0])
        miss[1] -= 2.0 / m.velocity_p_level_per_s * (y_m_s2 - force[1])
    for a in range(3):
        i = m.velocity_i_level_per_s2 if a < 2 else m.velocity_i_vertical_per_s2
        s.integral_m_s2[a] += miss[a] * i * dt_s * c.controlled[a]
    s.integral_m_s2[2] = _clipped(s.integral_m_s2[2], -m.gravity_m_s2, m.gravity_m_s2)


@part
def _root(error: float, gain: float, second: float, dt_s: float) -> float:
    """`sqrt_controller`: rate that removes an error >= 0, linear when near, at constant second derivative when far."""
    near = second / (gain * gain)
    rate = math.sqrt(2.0 * second * (error - 0.5 * near)) if error > near else error * gain
    return min(rate, error / dt_s) if dt_s > 0.0 else rate


@part
def _root_inverse(rate: float, gain: float, second: float) -> float:
    """The error at which `_root` gives a rate."""
    near = second / (gain * gain)
    return rate / gain if rate < second / gain else 0.5 * near + rate * rate / (2.0 * second)


@part
def _shape_acceleration(s: Row, vx: float, vy: float, c: Row, m: Row, dt_s: float) -> None:
    """`shape_vel_accel_xy`: desired acceleration towards a velocity, at most 1/sqrt(2) of it across that velocity."""
    most, jerk = c.correction_m_s2, m.jerk_level_m_s3
    ex, ey = vx - s.desired_m_s[0], vy - s.desired_m_s[1]
    error = math.hypot(ex, ey)
    scale = _root(error, jerk / most, jerk, dt_s) / max(error, TINY)
    ax, ay = ex * scale, ey * scale
    wanted = math.hypot(vx, vy)
    ux, uy = vx / max(wanted, TINY), vy / max(wanted, TINY)
    along = ux * ax + uy * ay
    cx, cy = ax - ux * along, ay - uy * along
    across = math.hypot(cx, cy)
    if wanted < TINY or along * along <= across * across:
        shorter = min(1.0, most / max(math.hypot(ax, ay), TINY))
        ax, ay = ax * shorter, ay * shorter
    else:
        shorter = min(1.0, most * math.sqrt(0.5) / max(across, TINY))
        left = math.sqrt(max(most * most - (across * shorter) ** 2, 0.0))
        along = _clipped(along, -left, left)
        ax, ay = cx * shorter + ux * along, cy * shorter + uy * along
    _shape_jerk(s, ax + s.target_m_s2[0], ay + s.target_m_s2[1], jerk * dt_s)


@part
def _shape_jerk(s: Row, ax: float, ay: float, most: float) -> None:
    """`shape_accel_xy`: turn the desired acceleration towards another, by at most so much."""
    dx, dy = ax - s.desired_m_s2[0], ay - s.desired_m_s2[1]
    share = min(1.0, most / max(math.hypot(dx, dy), TINY))
    s.desired_m_s2[0] += dx * share
    s.desired_m_s2[1] += dy * share


@part
def _shape(s: Row, c: Row, m: Row, dt_s: float) -> None:
    """`input_pos_vel_accel` and its kin: move the shaped target on, then turn it towards the target."""
    for a in range(3):
        s.desired_m[a] += s.desired_m_s[a] * dt_s + s.desired_m_s2[a] * (0.5 * dt_s * dt_s)
        s.desired_m_s[a] += s.desired_m_s2[a] * dt_s
    ex = (s.target_m[0] - s.desired_m[0]) * c.position_used[0]
    ey = (s.target_m[1] - s.desired_m[1]) * c.position_used[1]
    ez = (s.target_m[2] - s.desired_m[2]) * c.position_used[2]
    level, fastest, climb, descent = math.hypot(ex, ey), c.speed_m_s, c.climb_m_s, c.descent_m_s
    if s.level_kind == POSITION and s.vertical_kind == POSITION:  # `kinematic_limit`: straight to the destination
        upright = climb if ez < 0.0 else descent
        way = math.sqrt(level * level + ez * ez)
        whole = min(fastest * way / max(level, TINY), upright * way / max(abs(ez), TINY))
        fastest, climb = whole * level / max(way, TINY), whole * abs(ez) / max(way, TINY)
        descent = climb
    most = c.correction_m_s2
    if s.level_kind != 0:
        rate = _root(level, 0.5 * m.jerk_level_m_s3 / most, 0.5 * most, dt_s)
        scale = min(rate, fastest) / max(level, TINY)
        _shape_acceleration(s, ex * scale + s.target_m_s[0], ey * scale + s.target_m_s[1], c, m, dt_s)
    else:  # an acceleration alone
        _shape_jerk(s, s.target_m_s2[0], s.target_m_s2[1], m.jerk_level_m_s3 * dt_s)
    most, jerk = m.acceleration_vertical_m_s2, m.jerk_vertical_m_s3
    asked = 0.0
    if s.vertical_kind != 0:
        rate = _clipped(math.copysign(_root(abs(ez), 0.5 * jerk / most, 0.5 * most, dt_s), ez), -climb, descent)
        error = rate + s.target_m_s[2] - s.desired_m_s[2]
        asked = _clipped(math.copysign(_root(abs(error), jerk / most, jerk, dt_s), error), -most, most)
    change = asked + s.target_m_s2[2] - s.desired_m_s2[2]
    s.desired_m_s2[2] += _clipped(change, -jerk * dt_s, jerk * dt_s)


@part
def _begin(s: Row, c: Row, over: bool, resting: bool, keeps: bool) -> None:
    """Where other quantities are controlled than before, shaping begins anew at the estimate, without a jump."""
    level = POSITION * int(c.position_used[0] > 0.0) + VELOCITY * int(c.velocity_given[0] > 0.0 or over)
    vertical = POSITION * int(c.position_used[2] > 0.0) + VELOCITY * int(c.velocity_given[2] > 0.0 or over)
    for a in range(3):
        if (level == s.level_kind if a < 2 else vertical == s.vertical_kind) and not resting:
            continue
        s.desired_m[a], s.desired_m_s[a], s.desired_m_s2[a] = (
            s.estimated_position_m[a],
            s.estimated_velocity_m_s[a],
            0.0,
        )
        if keeps:  # what holds the vehicle
            s.miss_m_s[a] = s.miss_m_s2[a] = 0.0
            if resting or a < 2:
                s.integral_m_s2[a] = 0.0 if resting else s.correction_m_s2[a]
    s.level_kind, s.vertical_kind = level, vertical


@part
def _plan(s: Row, c: Row, m: Row, over: bool, resting: bool, dt_s: float) -> None:
    """A target that the autopilot chose itself: the direct law follows a shaped one on the way to it."""
    if not c.planned:
        s.level_kind = s.vertical_kind = -1  # shaping begins anew
        return
    _begin(s, c, over, resting, False)
    _shape(s, c, m, dt_s)
    for a in range(3):
        s.target_m[a], s.target_m_s[a], s.target_m_s2[a] = s.desired_m[a], s.desired_m_s[a], s.desired_m_s2[a]


@part
def _shaped_law(s: Row, c: Row, m: Row, time_s: float, dt_s: float, resting: bool) -> None:
    """Shaped target, P on position (`AC_P_2D`), PID on velocity (`AC_PID_2D`), PI on vertical acceleration.

    `update_NE_controller` and `update_U_controller` of AC_PosControl.
    """
    _begin(s, c, _aim(s, c, time_s, m.carries), resting, True)
    _shape(s, c, m, dt_s)
    gain, most = m.position_gain_level_per_s, c.correction_m_s2
    ex, ey = s.desired_m[0] - s.estimated_position_m[0], s.desired_m[1] - s.estimated_position_m[1]
    error = math.hypot(ex, ey)
    nearer = min(1.0, _root_inverse(c.speed_m_s, gain, most) / max(error, TINY))
    scale = nearer * _root(error * nearer, gain, most, 0.0) / max(error * nearer, TINY)
    gain, most = m.position_gain_vertical_per_s, m.acceleration_vertical_m_s2
    ez = s.desired_m[2] - s.estimated_position_m[2]
    ez = _clipped(ez, -_root_inverse(c.climb_m_s, gain, most), _root_inverse(c.descent_m_s, gain, most))
    # The shaped target does not run away from a vehicle that cannot follow.
    s.desired_m[0], s.desired_m[1] = s.estimated_position_m[0] + ex * nearer, s.estimated_position_m[1] + ey * nearer
    s.desired_m[2] = s.estimated_position_m[2] + ez
    blend = dt_s / (dt_s + 1.0 / (2.0 * math.pi * m.error_cutoff_hz))
    slower = dt_s / (dt_s + 1.0 / (2.0 * math.pi * m.derivative_cutoff_hz))
    approach = (ex * scale, ey * scale, math.copysign(_root(abs(ez), gain, most, 0.0), ez))
    force = s.asked_m_s2
    for a in range(3):
        miss = approach[a] + s.desired_m_s[a] - s.estimated_velocity_m_s[a]
        change = (miss - s.miss_m_s[a]) * blend
        s.miss_m_s[a] += change
        s.miss_m_s2[a] += (change / dt_s - s.miss_m_s2[a]) * slower
    for a in range(2):
        s.integral_m_s2[a] += s.miss_m_s[a] * m.velocity_i_level_per_s2 * dt_s
        force[a] = m.velocity_p_level_per_s * s.miss_m_s[a] + s.integral_m_s2[a] + m.velocity_d_level * s.miss_m_s2[a]
        s.correction_m_s2[a] = force[a]
        force[a] += s.desired_m_s2[a]
    _shorten_level(s.integral_m_s2, m.integral_most_m_s2)
    wanted = m.velocity_p_vertical_per_s * s.miss_m_s[2] + s.desired_m_s2[2]
    short = wanted - s.acceleration_m_s2[2]
    lift = 0.0 if resting else m.gravity_m_s2 - m.acceleration_p * short - s.integral_m_s2[2]
    if 0.0 < lift < m.thrust_most_m_s2:
        s.integral_m_s2[2] += m.acceleration_i_per_s * short * dt_s
    force[2] = -m.gravity_m_s2
    _shorten_level(force, m.gravity_m_s2 * math.tan(m.tilt_most_rad))
    stronger = max(lift, m.thrust_least_share * m.thrust_most_m_s2) / m.gravity_m_s2
    for a in range(3):
        force[a] *= stronger


@part
def _ground(s: Row, c: Row, k: Row) -> None:
    """A flat, soft ground: support from below, friction along it."""
    u, z_m = s.acceleration_m_s2, s.position_m[2]
    contact = z_m > -k.contact_m
    falling_m_s2 = u[2]
    if z_m >= 0.0 or (contact and not c.flying):
        support_m_s2 = -k.stiffness_per_s2 * z_m - k.damping_per_s * s.velocity_m_s[2]
        # Motors off just above the pad: the spring pulls down too, so that a rest is exactly at pad height.
        u[2] = min(falling_m_s2, support_m_s2) if c.flying else support_m_s2
    if contact and falling_m_s2 >= 0.0:
        u[0], u[1] = -k.friction_per_s * s.velocity_m_s[0], -k.friction_per_s * s.velocity_m_s[1]


@part
def _resting(s: Row, c: Row, k: Row) -> bool:
    """Whether a vehicle stands on the ground and is not asked to climb: a law starts from nothing there."""
    climbs = c.velocity_m_s[2] < 0.0 or (c.position_used[2] > 0.0 and c.position_m[2] < s.estimated_position_m[2])
    return not c.flying or (s.position_m[2] > -k.contact_m and not climbs)


@part
def _gusts(s: Row, d: Row, k: Row, dt_s: float) -> None:
    """Gusts: first-order Gauss-Markov."""
    forget = dt_s / k.gust_time_s
    for a in range(3):
        s.gust_m_s[a] -= forget * s.gust_m_s[a]
    _add_noise(s, s.gust_m_s, d.gust_m_s * math.sqrt(2.0 * forget))


@part
def _move(s: Row, k: Row, dt_s: float) -> None:
    """The discrete dynamics: x+ = x + v dt + u dt^2 / 2, v+ = v + u dt; and whether and how the ground is touched."""
    u = s.acceleration_m_s2
    for a in range(3):
        s.position_m[a] += s.velocity_m_s[a] * dt_s + u[a] * (0.5 * dt_s * dt_s)
        s.velocity_m_s[a] += u[a] * dt_s
    contact = s.position_m[2] > -k.contact_m
    if contact and not s.in_contact:
        s.impact_m_s = _length(s.velocity_m_s)
    s.in_contact = contact


@part
def _limit_body_speed(s: Row, most_m_s: float, dt_s: float) -> None:
    """An acceleration after which a flying particle does not exceed the body's speed."""
    u, v = s.acceleration_m_s2, s.velocity_m_s
    x, y, z = v[0] + u[0] * dt_s, v[1] + u[1] * dt_s, v[2] + u[2] * dt_s
    speed_m_s = math.sqrt(x * x + y * y + z * z)
    if speed_m_s > most_m_s:
        scale = most_m_s / speed_m_s
        u[0], u[1], u[2] = (x * scale - v[0]) / dt_s, (y * scale - v[1]) / dt_s, (z * scale - v[2]) / dt_s


@part
def _turn(s: Row, c: Row, m: Row, dt_s: float) -> None:
    """Yaw at a bounded rate, the short way round, as far as it can still be stopped."""
    wanted = 0.0
    if c.flying and c.yaw_used:
        miss = (c.yaw_rad - s.yaw_rad + math.pi) % (2.0 * math.pi) - math.pi
        stoppable = math.sqrt(1.6 * m.yaw_acceleration_most_rad_s2 * abs(miss))
        wanted = _clipped(m.yaw_gain_per_s * miss, -stoppable, stoppable)
    elif c.flying:
        wanted = c.yaw_rate_rad_s
    wanted = _clipped(wanted, -m.yaw_rate_most_rad_s, m.yaw_rate_most_rad_s)
    step = m.yaw_acceleration_most_rad_s2 * dt_s
    s.yaw_rate_rad_s = _clipped(wanted, s.yaw_rate_rad_s - step, s.yaw_rate_rad_s + step)
    s.yaw_rad = (s.yaw_rad + s.yaw_rate_rad_s * dt_s + math.pi) % (2.0 * math.pi) - math.pi


@part
def _drift(s: Row, d: Row, m: Row, dt_s: float) -> None:
    """Dead reckoning: errors of acceleration are integrated twice; GPS takes the drift back."""
    if d.gps_lost:
        noises = _normals(s)
        for a in range(2):
            s.drift_m[a] += s.drift_m_s[a] * dt_s
            s.drift_m_s[a] += m.drift_m_s2[a] * dt_s + m.drift_noise_m_s2 * math.sqrt(dt_s) * noises[a]
    else:
        keep = max(0.0, 1.0 - dt_s / m.recovery_time_s)
        for a in range(2):
            s.drift_m[a] *= keep
            s.drift_m_s[a] *= keep


@part
def _wander(s: Row, c: Row, m: Row, dt_s: float) -> None:
    """Slow errors of the estimator (Gauss-Markov): the position's gathers a share of the velocity's."""
    forget = dt_s / m.wander_velocity_time_s
    for a in range(3):
        first, second = _normals(s)
        strength = m.wander_sigma_m_s[a] * math.sqrt(2.0 * forget) if c.flying else 0.0
        s.wander_m_s[a] += -forget * s.wander_m_s[a] + strength * first
        share = dt_s / m.wander_time_s[a]
        s.wander_m[a] += m.wander_share * s.wander_m_s[a] * dt_s - share * s.wander_m[a]
        s.wander_m[a] += m.wander_sigma_m[a] * math.sqrt(2.0 * share) * second


@part
def _observe(s: Row, d: Row, dt_s: float) -> None:
    """What the autopilot believes after this step: the truth and all errors."""
    for a in range(3):
        s.error_m[a] = s.wander_m[a] + s.drift_m[a] + d.estimate_offset_m[a]
        s.error_m_s[a] = s.wander_m_s[a] + s.drift_m_s[a]
    if d.estimate_noise_m > 0.0:
        _add_noise(s, s.error_m, d.estimate_noise_m)
    _estimate(s, d)


@part
def _estimate(s: Row, d: Row) -> None:
    if not d.estimate_frozen:
        for a in range(3):
            s.estimated_position_m[a] = s.position_m[a] + s.error_m[a]
            s.estimated_velocity_m_s[a] = s.velocity_m_s[a] + s.error_m_s[a]


@kernel
def step_particles(
    state: Row, commands: Row, disturbances: Row, models: Row, world: Row, first: int, dt_s: float, steps: int
) -> None:
    """Advance particles, the paper's discrete dynamics, by a number of steps; `first` steps were made before."""
    k = world[0]
    for row in range(state.shape[0]):
        s, c, d, m = state[row], commands[row], disturbances[row], models[row]
        for step in range(first, first + steps):
            _estimate(s, d)
            if d.gust_m_s > 0.0 or s.gust_m_s[0] != 0.0:
                _gusts(s, d, k, dt_s)
            _particle(s, c, d, m, k, step * dt_s, dt_s)
            _ground(s, c, k)
            if c.flying:
                _limit_body_speed(s, k.body_speed_m_s, dt_s)
            _move(s, k, dt_s)
            _turn(s, c, m, dt_s)
            _drift(s, d, m, dt_s)
            _observe(s, d, dt_s)


@kernel
def step_measured(
    state: Row, commands: Row, disturbances: Row, models: Row, world: Row, law: int, first: int, dt_s: float, steps: int
) -> None:
    """Advance multicopters with a real autopilot's control law, by its place in `flight_model.LAWS`."""
    k = world[0]
    for row in range(state.shape[0]):
        s, c, d, m = state[row], commands[row], disturbances[row], models[row]
        for step in range(first, first + steps):
            _estimate(s, d)
            resting = _resting(s, c, k)
            if law == SHAPED:
                _shaped_law(s, c, m, step * dt_s, dt_s, resting)
            else:
                _direct_law(s, c, m, step * dt_s, dt_s, resting)
            if d.gust_m_s > 0.0 or s.gust_m_s[0] != 0.0:
                _gusts(s, d, k, dt_s)
            _airframe(s, c, d, m, dt_s)
            _ground(s, c, k)
            _move(s, k, dt_s)
            _turn(s, c, m, dt_s)
            _drift(s, d, m, dt_s)
            _wander(s, c, m, dt_s)
            _observe(s, d, dt_s)
