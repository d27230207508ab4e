"""Filter arrays: where a robot with a gyro and wheel encoders is after a figure of eight and half a circle.

python tools/examples/filter_arrays.py
"""

import numpy as np

import drd

# The true drive: 10 s of standstill, then circles of 2 m radius at 0.5 m/s, to the left and to the right in turn.
dt_s, circle_s = 0.05, 8.0 * np.pi
time_s = np.arange(0.0, 10.0 + 2.5 * circle_s, dt_s)
speed_m_s = np.where(time_s > 10.0, 0.5, 0.0)
turn_rad_s = 0.5 * speed_m_s * np.where((time_s - 10.0) // circle_s == 1, -1.0, 1.0)
heading_rad = np.cumsum(turn_rad_s) * dt_s
x_m, y_m = (np.cumsum(speed_m_s * f(heading_rad)) * dt_s for f in (np.cos, np.sin))

# What the sensors show: the gyro has noise and a bias of 0.02 deg/s, the wheels are 0.5 % smaller than stated.
rate_deg_s = np.degrees(turn_rad_s) + 0.02 + 0.02 * np.random.default_rng(1).standard_normal(len(time_s))
travel_m = [np.cumsum(speed_m_s + side_m * turn_rad_s) * dt_s for side_m in (-0.25, 0.25)]
left, right = (np.round(m / (2.0 * np.pi * 0.0995) * 4096) for m in travel_m)

robot = drd.Robot(wheel_radius_m=0.1, tread_m=0.5, counts_per_revolution=4096, standstill_at_start_s=10.0)
gyro = {"time_s": time_s, "rate_deg_s": rate_deg_s}
wheels = {"time_s": time_s, "left_counts": left, "right_counts": right}
poses = drd.run_filter(gyro, wheels, robot)

for name, x, y, rad in (("end", poses.x_m, poses.y_m, poses.heading_rad), ("true end", x_m, y_m, heading_rad)):
    print(f"{name}: x {x[-1]:.3f} m, y {y[-1]:.3f} m, heading {np.degrees(rad[-1]):.2f} deg")
print(f"within {poses.position_bound_m[-1]:.3f} m in 99 of 100 cases, {poses.validity[-1]}")
