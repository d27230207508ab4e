"""Diagnose arrays, of a simulated robot whose gyro reads turns 1 % too large, and whose tread is 5 % off.

python tools/examples/diagnose_arrays.py [FOLDER]      (with a folder: diagnosis.json, model.yaml, report.html)
"""

import sys
from pathlib import Path

import numpy as np

from drd import Robot
from drd.effects.catalogue import catalogue
from drd_tools.diagnose import diagnose
from drd_tools.simulate.missions import make_drive
from drd_tools.simulate.robot import DEFAULT
from drd_tools.simulate.simulator import simulate
from drd_tools.simulate.truth import make_truth

true = [(catalogue()["gyro_scale_error"], {"k": 0.01}), (catalogue()["tread_error"], {"k": 0.05})]
recording = simulate(make_truth(make_drive("slalom", 60.0)), DEFAULT, true, seed=1).recording
fog, encoders, pose = recording.fog, recording.encoders, recording.reference
assert fog is not None
assert pose is not None

# What a robot has: columns of numbers. A DataFrame with these columns does as well.
gyro = {"time_s": fog.time_s, "rate_deg_s": np.degrees(fog.rate_rad_s), "temperature_c": fog.temperature_c}
wheels = {"time_s": encoders.time_s, "left_counts": encoders.left_counts, "right_counts": encoders.right_counts}
reference = {"time_s": pose.time_s, "x_m": pose.x_m, "y_m": pose.y_m, "heading_deg": np.degrees(pose.heading_rad)}

robot = Robot(
    wheel_radius_m=0.11,
    tread_m=0.52,
    counts_per_revolution=20000,
    gyro_angle_random_walk_deg_per_sqrt_h=0.083,
    slip_noise_m_per_sqrt_m=0.002,
    reference_position_sigma_m=0.01,
    reference_heading_sigma_deg=0.15,
    standstill_at_start_s=10,
)
diagnosis = diagnose(gyro, wheels, robot, reference=reference)

print(diagnosis.verdict)
for finding in diagnosis.findings:
    print(f"{finding.effect}: probability {finding.probability:.3f}, {finding.status}")
    for name, amount in finding.parameters.items():
        print(f"  {name} = {amount.value:.5f} +- {amount.std:.5f} {amount.unit}")
    print(f"  in {finding.windows}; also fits: {', '.join(finding.also_fits) or 'nothing else'}")
print("model:", ", ".join(term.effect.id for term in diagnosis.model.terms))
if len(sys.argv) > 1:
    print("files:", *diagnosis.report(Path(sys.argv[1])))
