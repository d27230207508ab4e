"""The emulator's sensors without any error."""

from drd_tools.emulate.sensors import SensorErrors

PERFECT = SensorErrors(
    bias_deg_s=0.0,
    scale_error=0.0,
    angle_random_walk_deg_per_sqrt_h=0.0,
    clock_error_percent=0.0,
    warm_up_c=0.0,
    left_radius_error=0.0,
    right_radius_error=0.0,
    tread_error=0.0,
    slip_m_per_sqrt_m=0.0,
)
