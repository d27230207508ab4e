"""Every configuration key of the daemon: type, unit, range, default and when to change it."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

from msgspec import Meta

PublishOn = Literal["wheels", "gyro"]


@dataclass(frozen=True, kw_only=True)
class Robot:
    """The robot's nominal geometry."""

    name: str = "robot"
    """Name of the robot, shown in health and logs"""
    wheel_radius_m: Annotated[float, "m", Meta(ge=0.005, le=5)]
    """Rolling radius of the wheels under load"""
    left_scale: Annotated[float, Meta(ge=0.5, le=1.5)] = 1.0
    """Factor on the left wheel's travel (UMBmark's c_l); change after a calibration"""
    right_scale: Annotated[float, Meta(ge=0.5, le=1.5)] = 1.0
    """Factor on the right wheel's travel (UMBmark's c_r); change after a calibration"""
    tread_m: Annotated[float, "m", Meta(ge=0.02, le=20)]
    """Effective tread (track width): distance between left and right wheels; for skid-steer robots 1.0 to 1.9 times the
    measured one"""
    drive: Literal["auto", "differential", "skid"] = "auto"
    """How it steers: differential = two wheels and casters; skid = wheels slip sideways in each turn (four wheels,
    tracks); auto = differential, until the gyro shows an effective tread other than the stated one"""
    max_speed_m_s: Annotated[float, "m/s", Meta(ge=0.01, le=100)] = 3.0
    """Faster wheel travel is a counter jump, not motion; set to 1.5 times the robot's top speed"""
    max_acceleration_deg_s2: Annotated[float, "deg/s^2", Meta(ge=10, le=1e6)] = 500.0
    """A gyro reading that implies more is taken for corrupted; lower it to the robot's capability"""


@dataclass(frozen=True, kw_only=True)
class Ecore:
    """Profile of the E-Core's payload bytes m1 to m4. No manual is public: this is an assumption, change it."""

    status_byte: Annotated[int, Meta(ge=0, le=4)] = 1
    """Payload byte that holds the status bits; 0 = none"""
    status_mask: Annotated[int, Meta(ge=0, le=255)] = 0
    """Status bits that are evaluated; 0 = never reported invalid"""
    status_good: Annotated[int, Meta(ge=0, le=255)] = 0
    """Value of the masked status bits when the reading is valid"""
    temperature_byte: Annotated[int, Meta(ge=0, le=3)] = 3
    """First payload byte of the big-endian int16 temperature; 0 = none"""
    temperature_scale_c: Annotated[float, "degC", Meta(ge=1e-6, le=10)] = 0.01
    """Temperature of one count"""
    temperature_offset_c: Annotated[float, "degC", Meta(ge=-300, le=300)] = 0.0
    """Temperature at count zero"""


@dataclass(frozen=True, kw_only=True)
class Dsp3000:
    """KVH DSP-3000, ASCII lines."""

    mode: Literal["rate", "incremental", "integrated"] = "rate"
    """Meaning of word 1 of a line, as set in the gyro: rate (R), incremental angle (A) or integrated angle (P)"""


@dataclass(frozen=True, kw_only=True)
class Dsp17xx:
    """KVH DSP-1760, 1725, 1750 and 1775, 36-byte binary format A."""

    rotation: Literal["delta", "rate"] = "delta"
    """What the gyro is set to send (=rotfmt)"""
    angle_unit: Literal["radians", "degrees"] = "radians"
    """Unit the gyro is set to send (=rotunits)"""
    temperature_scale_c: Annotated[float, "degC", Meta(ge=0.001, le=10)] = 1.0
    """Temperature of one count: 1, or 0.01 after =tempunits,C_100"""


@dataclass(frozen=True, kw_only=True)
class Fog:
    """The fibre-optic gyro and its serial port."""

    protocol: Literal["ecore", "dsp3000", "dsp17xx", "none"] = "ecore"
    """Protocol of the gyro; none = the robot has no gyro"""
    port: Annotated[str, "path"] = "/dev/fog"
    """Serial device; prefer a stable name from udev"""
    baud: Annotated[int, "bit/s", Meta(ge=300, le=4_147_200)] = 9600
    """Line speed"""
    rate_hz: Annotated[float, "Hz", Meta(ge=0.5, le=2000)] = 10.0
    """Nominal output rate; the true rate is measured"""
    full_scale_deg_s: Annotated[float, "deg/s", Meta(ge=1, le=5000)] = 100.0
    """Largest rate the gyro can report; readings beyond 99.9 % of it are over-range. Scales the E-Core's counts"""
    positive: Literal["clockwise", "counterclockwise"] = "clockwise"
    """Direction of rotation that the gyro reports as positive, seen from above; KVH gyros count clockwise.
    counterclockwise when mounted upside down"""
    axis: Literal["x", "y", "z"] = "z"
    """Sensor axis that points up; single-axis gyros have only z"""
    latency_s: Annotated[float, "s", Meta(ge=0, le=1)] = 0.0
    """Time from the end of a measurement interval to the arrival of the last byte of its packet: the gyro's filter
    delay plus transmission"""
    silent_after_s: Annotated[float, "s", Meta(ge=0.01, le=60)] = 0.5
    """Silence after which the health reports it"""
    low_latency: bool = True
    """Ask the serial driver for low latency; change only if the driver misbehaves"""
    ecore: Ecore = Ecore()
    dsp3000: Dsp3000 = Dsp3000()
    dsp17xx: Dsp17xx = Dsp17xx()


@dataclass(frozen=True, kw_only=True)
class Wheel:
    """One side: where its counter is on the bus."""

    node: Annotated[int, Meta(ge=0, le=255)] = 1
    """Node or controller id on the bus (cia406, odrive, vesc)"""
    reversed: bool = False
    """True when the counter falls while the robot drives forward"""
    message: str | None = None
    """DBC message that holds this side's signal (dbc)"""
    signal: str | None = None
    """DBC signal with this side's counts or speed (dbc)"""


@dataclass(frozen=True, kw_only=True)
class Left(Wheel):
    """The left wheel's counter."""


@dataclass(frozen=True, kw_only=True)
class Right(Wheel):
    """The right wheel's counter."""

    node: Annotated[int, Meta(ge=0, le=255)] = 2


@dataclass(frozen=True, kw_only=True)
class Cia406:
    """CANopen encoders, one node per wheel."""

    tpdo: Annotated[int, Meta(ge=1, le=4)] = 1
    """Which TPDO carries the position (object 6004h)"""
    byte_offset: Annotated[int, Meta(ge=0, le=7)] = 0
    """First byte of the position in that TPDO"""
    byte_length: Annotated[int, "bytes", Meta(ge=1, le=8)] = 4
    """Bytes of the position, little-endian unsigned"""
    sync_period_s: Annotated[float, "s", Meta(ge=0.001, le=10)] | None = None
    """Send SYNC this often, so that both wheels are sampled together (TPDO2, synchronous); null = listen only"""
    start_nodes: bool = False
    """Send NMT start to both nodes at opening and after a node's boot-up message; true where no other master does it"""


@dataclass(frozen=True, kw_only=True)
class Odrive:
    """ODrive CAN Simple."""

    message: Literal["estimates", "counts"] = "estimates"
    """Cyclic message to read: estimates (0x009, float revolutions) or counts (0x00A, firmware up to 0.5.6; finer over
    long distances)"""
    gear_ratio: Annotated[float, Meta(ge=0.01, le=1000)] = 1.0
    """Turns of the encoder shaft per wheel turn, for estimates; for counts it is part of counts_per_revolution"""


@dataclass(frozen=True, kw_only=True)
class Vesc:
    """VESC STATUS_5 tachometer."""

    pole_pairs: Annotated[int, Meta(ge=1, le=100)] = 7
    """Pole pairs of the motor: 6 tachometer counts per pair and motor turn"""
    gear_ratio: Annotated[float, Meta(ge=0.01, le=1000)] = 1.0
    """Motor turns per wheel turn"""


@dataclass(frozen=True, kw_only=True)
class Dbc:
    """Any other layout, described by a DBC file (needs the extra drd[dbc])."""

    file: Annotated[str, "path"] | None = None
    """DBC file, relative to this configuration"""
    quantity: Literal["counts", "speed"] = "counts"
    """What the two signals are: counts, or speed at the wheel's rim"""
    speed_unit_m_s: Annotated[float, "m/s", Meta(ge=1e-6, le=100)] = 1.0
    """One unit of the speed signal; 0.277778 for km/h"""


@dataclass(frozen=True, kw_only=True)
class Encoders:
    """The wheel encoders and their CAN interface."""

    layout: Literal["cia406", "agilex", "odrive", "vesc", "dbc"] = "cia406"
    """Layout of the CAN frames"""
    interface: str = "socketcan"
    """python-can interface: socketcan on robots, slcan for a serial adapter"""
    channel: str = "can0"
    """Interface name, or the serial device of an slcan adapter"""
    bitrate: Annotated[int, "bit/s", Meta(ge=10_000, le=1_000_000)] | None = None
    """Bus speed for slcan and vendor adapters; that of socketcan is set by the system"""
    open_delay_s: Annotated[float, "s", Meta(ge=0, le=10)] = 0.0
    """Wait after opening an slcan adapter; 2 for Arduino-like ones that restart"""
    counts_per_revolution: Annotated[float, "counts", Meta(ge=1, le=1e9)] | None = None
    """Counts per wheel turn (cia406, odrive counts, dbc counts), gear included; the other layouts define theirs"""
    modulus_counts: Annotated[int, "counts", Meta(ge=4)] | None = None
    """Count at which the counter starts again at zero (cia406: object 6002h, or 2^bits); null = the layout's own"""
    rate_hz: Annotated[float, "Hz", Meta(ge=1, le=1000)] = 20.0
    """Nominal rate of the counters"""
    latency_s: Annotated[float, "s", Meta(ge=0, le=1)] = 0.0
    """Time from the sampling of a counter to its frame on the bus"""
    pair_window_s: Annotated[float, "s", Meta(ge=0.0005, le=1)] = 0.04
    """Left and right readings further apart than this, and than 0.75 periods of rate_hz, are not paired"""
    gap_s: Annotated[float, "s", Meta(ge=0.02, le=10)] = 0.5
    """After a longer gap the first counts move the pose, but its bound stays as wide as without them"""
    silent_after_s: Annotated[float, "s", Meta(ge=0.02, le=60)] = 0.3
    """Silence after which the health reports it"""
    queue_frames: Annotated[int, "frames", Meta(ge=16, le=1_000_000)] = 1024
    """Frames kept while the estimator is busy; more are dropped and counted"""
    left: Left = Left()
    right: Right = Right()
    cia406: Cia406 = Cia406()
    odrive: Odrive = Odrive()
    vesc: Vesc = Vesc()
    dbc: Dbc = Dbc()


@dataclass(frozen=True, kw_only=True)
class StaticBias:
    """The gyro's bias, measured while the robot stands before a mission."""

    duration_s: Annotated[float, "s", Meta(ge=0, le=600)] = 10.0
    """Averaging time at standstill; 0 skips it. 10 s leaves 1.6 deg/h (RD2100 class)"""
    minimum_s: Annotated[float, "s", Meta(ge=0.1, le=600)] = 5.0
    """Shorter standstills, cut by motion, are not used; the bias then starts from zero with the datasheet's
    uncertainty"""


@dataclass(frozen=True, kw_only=True)
class Initial:
    """Standard deviations at the start; for parameters that a model corrects, the model's, if smaller."""

    position_m: Annotated[float, "m", Meta(ge=0, le=1e6)] = 0.0
    """Start position"""
    heading_deg: Annotated[float, "deg", Meta(ge=0, le=180)] = 0.0
    """Start heading"""
    wheel_scale: Annotated[float, "1", Meta(ge=0, le=0.5)] | None = None
    """Each wheel radius, relative to nominal; null = 0.005, or 0.04 for skid steering"""
    tread: Annotated[float, "1", Meta(ge=0, le=1)] | None = None
    """Tread, relative to nominal; null = 0.02 as measured by tape, or 0.5 if a gyro can determine the effective one"""
    gyro_scale: Annotated[float, "1", Meta(ge=0, le=0.5)] = 0.005
    """Gyro scale factor, if it is estimated: the default suits a fibre-optic gyro; 0.03 for a MEMS chip as delivered"""
    wheel_lag_s: Annotated[float, "s", Meta(ge=0, le=1)] = 0.2
    """Lag of the wheels' samples behind the gyro's, beyond the stated latencies; 0 = none"""
    slip_s: Annotated[float, "s", Meta(ge=0, le=5)] | None = None
    """Lateral slip: lateral speed over forward speed times yaw rate; null = 0, or 0.25 for skid steering"""
    gyro_bias_deg_s: Annotated[float, "deg/s", Meta(ge=0, le=10)] = 0.02
    """Gyro bias when no standstill was measured (bias repeatability)"""


@dataclass(frozen=True, kw_only=True)
class Noise:
    """The physical noise profile, in datasheet units."""

    wheel_m_per_sqrt_m: Annotated[float, "m/sqrt(m)", Meta(ge=0, le=1)] = 0.002
    """Each wheel's travel noise: slip, bumps; 0.0005 indoors, 0.005 off-road"""
    lateral_m_per_sqrt_m: Annotated[float, "m/sqrt(m)", Meta(ge=0, le=1)] = 0.001
    """Lateral drift on straight lines"""
    turn_rad_per_sqrt_rad: Annotated[float, "rad/sqrt(rad)", Meta(ge=0, le=1)] = 0.02
    """Heading noise of the wheels when turning: 0.005 for two driven wheels, 0.05 or more for skid-steer"""
    turn_m_per_sqrt_rad: Annotated[float, "m/sqrt(rad)", Meta(ge=0, le=1)] = 0.005
    """Position noise when turning (the centre of rotation wanders)"""
    wheel_scale_per_sqrt_m: Annotated[float, "1/sqrt(m)", Meta(ge=0, le=0.1)] = 2e-5
    """Slow change of each wheel's scale: tyre, load"""
    tread_per_sqrt_rad: Annotated[float, "1/sqrt(rad)", Meta(ge=0, le=1)] = 0.002
    """Change of the tread (relative) while turning: ground changes; 0.01 for skid-steer"""
    gyro_deg_per_sqrt_h: Annotated[float, "deg/sqrt(h)", Meta(ge=0, le=100)] = 0.083
    """Angle random walk of the gyro"""
    gyro_bias_deg_h_per_sqrt_h: Annotated[float, "deg/h/sqrt(h)", Meta(ge=0, le=1e4)] = 3.7
    """Rate random walk of the gyro"""
    gyro_bias_repeatability_deg_s: Annotated[float, "deg/s", Meta(ge=0, le=10)] = 0.002
    """Change of the gyro's bias when it is switched off and on; added after each silence of the gyro"""
    gyro_scale_per_sqrt_h: Annotated[float, "1/sqrt(h)", Meta(ge=0, le=1)] = 2e-4
    """Slow change of the gyro's scale, where it is estimated"""
    comparison_deg: Annotated[float, "deg", Meta(ge=1e-6, le=10)] = 0.02
    """Noise floor of the heading innovation: encoder and gyro resolution"""
    timing_s: Annotated[float, "s", Meta(ge=0, le=1)] = 0.002
    """Uncertainty of the gyro's time relative to the encoders'"""


@dataclass(frozen=True, kw_only=True)
class Estimation:
    """Odometry and the indirect feedback Kalman filter."""

    heading: Literal["filter", "gyro"] = "filter"
    """Source of the heading: filter = gyro and wheels, fused by the Kalman filter; gyro = the gyro alone, the wheels
    give only the distance (the paper's runs without filter). Change it if the wheels skid so much that their turning is
    meaningless"""
    profile: Literal["physical", "paper"] = "physical"
    """Noise: physical (per metre, radian and second) or paper (its printed Q and R)"""
    gyro_scale: Literal["auto", "yes", "no"] = "auto"
    """Estimate the gyro's scale: auto = unless a calibration is loaded (as the paper does)"""
    midpoint: bool = True
    """Advance along the heading in the middle of a step; false = the paper's equation 7, as printed"""
    gate_sigma: Annotated[float, "sigma", Meta(ge=1, le=100)] = 5.0
    """Innovation gate: larger disagreement of gyro and wheels is rejected"""
    rejections_before_release: Annotated[int, Meta(ge=1, le=1000)] = 3
    """Consecutive rejections after which the wheels' heading is taken for slip and reset to the gyro's"""
    invalid_after_s: Annotated[float, "s", Meta(ge=0.1, le=3600)] = 10.0
    """Silence of the encoders after which the pose is invalid"""
    max_position_bound_m: Annotated[float, "m", Meta(ge=0.001, le=1e6)] | None = None
    """Position bound beyond which the pose is invalid; null = never"""
    reorder_s: Annotated[float, "s", Meta(ge=0.01, le=5)] = 0.25
    """How long one sensor waits for the other before the estimate continues without it"""
    static_bias: StaticBias = StaticBias()
    initial: Initial = Initial()
    noise: Noise = Noise()


@dataclass(frozen=True, kw_only=True)
class CalibrationFile:
    """The gyro's stored calibration."""

    file: Annotated[str, "path"] | None = None
    """Calibration file (temperature-varying cubic), relative to this configuration; null = none"""


@dataclass(frozen=True, kw_only=True)
class ModelFile:
    """Physical effects beyond the nominal robot, for which the samples are corrected."""

    file: Annotated[str, "path"] | None = None
    """Model file (effects of drd's catalogue with their parameters), relative to this configuration; null = none"""


@dataclass(frozen=True, kw_only=True)
class Ros2Topics:
    """ROS 2 topics besides the odometry: in its namespace, or absolute with a slash; null = not published."""

    tf: str | None = "/tf"
    """Transform from frame_id to child_frame_id; null if another node, such as robot_localization, publishes it"""
    imu: str | None = "imu"
    """Yaw rate without its bias and heading (sensor_msgs/Imu), in child_frame_id"""
    diagnostics: str | None = "/diagnostics"
    """Validity and reasons, as often as the health"""
    joint_states: str | None = "joint_states"
    """Wheel angles from the counts, if ros2_joints names the joints"""


@dataclass(frozen=True, kw_only=True)
class Output:
    """Publication of the pose over Zenoh."""

    prefix: str = "drd"
    """Prefix of all keys"""
    frame_id: str = "odom"
    """Frame of the pose in odom messages"""
    child_frame_id: str = "base_link"
    """Frame of the robot in odom messages"""
    publish_on: PublishOn = "wheels"
    """Samples that publish a pose: wheels, or gyro (at most at the encoders' rate)"""
    health_period_s: Annotated[float, "s", Meta(ge=0.1, le=60)] = 1.0
    """How often the health is published"""
    listen: Annotated[tuple[str, ...], "Zenoh endpoints"] = ("tcp/127.0.0.1:7447",)
    """Zenoh endpoints to listen on; the default can be reached from this machine only"""
    connect: Annotated[tuple[str, ...], "Zenoh endpoints"] = ()
    """Zenoh endpoints to connect to, such as a router"""
    zenoh_config: Annotated[str, "path"] | None = None
    """Zenoh's own configuration file (JSON5), relative to this one; listen and connect are then ignored.
    zenoh-tls.json5 is one with certificates and access control"""
    max_sessions: Annotated[int, Meta(ge=1, le=1000)] = 256
    """Maximum number of simultaneous Zenoh sessions; more are refused. Each takes 0.1 MB and, at 20 poses per second,
    0.1 % of a core. Ignored with zenoh_config"""
    commands: bool = False
    """Allow set_pose, reset and calibrate_bias over Zenoh, for anyone who can reach an endpoint or, with zenoh_config,
    for those permitted by its access_control; each command is logged"""
    ros2: bool = False
    """Act as a ROS 2 node (rmw_zenoh): odometry and ros2_topics; with commands, also the services set_pose and reset.
    Connect to its router, tcp/localhost:7447, and change listen"""
    ros2_domain: Annotated[int, Meta(ge=0, le=232)] = 0
    """ROS_DOMAIN_ID"""
    ros2_topic: str = "odom"
    """ROS 2 topic of the odometry, namespace included"""
    ros2_hash: bool = True
    """Type hash in the key (Iron and later); false for Humble"""
    ros2_joints: Annotated[tuple[str, ...], "joints, left and right"] = ()
    """The two wheels' joints in the robot's description, left and right; none: no joint states"""
    ros2_topics: Ros2Topics = Ros2Topics()

    def beside(self, folder: Path) -> "Output":
        """This section with its file found from `folder`, where the configuration lies."""
        return self if self.zenoh_config is None else replace(self, zenoh_config=str(folder / self.zenoh_config))


@dataclass(frozen=True, kw_only=True)
class Recording:
    """MCAP files with all inputs and outputs, for replay and viewers."""

    enabled: bool = False
    """Record every run of the daemon: about 50 MB per hour at 20 poses per second"""
    viewers: bool = True
    """Also write transform, pose, path and bound in the form that Foxglove and Rerun draw: 11 MB of those"""
    folder: Annotated[str, "path"] = "recordings"
    """Where the files go; relative to the service's state directory (/var/lib/drd-NAME) under systemd, else to the
    working directory"""
    flush_s: Annotated[float, "s", Meta(ge=0.1, le=60)] = 0.5
    """How often data are passed to the operating system: at most this much is lost if the daemon is killed"""
    fsync_s: Annotated[float, "s", Meta(ge=0.1, le=3600)] = 0.5
    """How often data are synced to the disk: at most this much is lost in a power cut; longer spares flash"""
    max_file_mb: Annotated[float, "MB", Meta(ge=1, le=100_000)] = 64.0
    """A larger file is continued in a new one"""
    max_file_age_s: Annotated[float, "s", Meta(ge=10, le=1e6)] = 3600.0
    """An older file is continued in a new one"""
    max_total_mb: Annotated[float, "MB", Meta(ge=2, le=10_000_000)] = 2000.0
    """The oldest files of this robot are deleted beyond this"""


@dataclass(frozen=True, kw_only=True)
class State:
    """What the daemon remembers across a restart, and how far it is trusted then."""

    enabled: bool = True
    """Keep the state, and continue from it at the start"""
    folder: Annotated[str, "path"] | None = None
    """Where the file lies; relative to the service's state directory (/var/lib/drd-NAME) under systemd, else to the
    working directory. null = that directory under systemd, else no state is kept"""
    period_s: Annotated[float, "s", Meta(ge=0.5, le=3600)] = 4.0
    """How often it is written, besides each time the robot starts to move or drd ends; longer spares flash, but leaves
    more unseen motion if drd is killed while moving"""
    pose: Literal["continue", "origin"] = "continue"
    """Where the robot is at the start: continue = where it was, origin = back at the origin with the uncertainty of
    estimation.initial, for robots that restart at their dock; what was learned is kept either way"""
    believed_s: Annotated[float, "s", Meta(ge=0, le=1e9)] = 600.0
    """After a longer time off, or an unknown one, the robot may have been carried: the pose continues, but is degraded
    until set_pose or reset. Increase it if nobody can carry the robot"""
    position_m: Annotated[float, "m", Meta(ge=0, le=1e4)] = 0.2
    """How far a standing robot may have been pushed while drd was off, standard deviation of each coordinate; 0 with
    brakes"""
    heading_deg: Annotated[float, "deg", Meta(ge=0, le=180)] = 5.0
    """How far it may have been turned meanwhile, standard deviation; 0 with brakes"""
    wheel_scale: Annotated[float, "1", Meta(ge=0, le=0.5)] = 5e-4
    """How much each wheel's radius may have changed meanwhile: load, tyres, temperature"""
    tread: Annotated[float, "1", Meta(ge=0, le=1)] = 0.005
    """How much the tread may have changed meanwhile: another ground; 0.05 for skid-steer"""


@dataclass(frozen=True, kw_only=True)
class Monitor:
    """A separate process that identifies what has changed in the robot. It changes no pose unless `apply` is true."""

    enabled: bool = True
    """Run it, if there is a gyro and no model.file: 1 to 2 % of a core, 100 MB. Its false-alarm rate is in
    drd/monitor/README.md: use its findings as hints, but let nothing depend on them"""
    apply: bool = False
    """Let the estimator adopt the radii, tread times scale and lag that it is sure of; false restores the previous
    values. Benefits and risks are in drd/monitor/README.md"""


@dataclass(frozen=True, kw_only=True)
class Realtime:
    """Scheduling; if the system does not permit a setting, a message is logged and the daemon runs without it."""

    freeze_gc: bool = True
    """Exclude start-up objects from garbage collection"""
    lock_memory: bool = False
    """Lock all memory (mlockall); needs LimitMEMLOCK"""
    fifo_priority: Annotated[int, Meta(ge=0, le=99)] = 0
    """SCHED_FIFO priority; 0 = normal scheduling. Needs LimitRTPRIO"""


@dataclass(frozen=True, kw_only=True)
class Config:
    """The whole configuration file."""

    robot: Robot
    fog: Fog = Fog()
    encoders: Encoders = Encoders()
    calibration: CalibrationFile = CalibrationFile()
    model: ModelFile = ModelFile()
    estimation: Estimation = Estimation()
    output: Output = Output()
    recording: Recording = Recording()
    state: State = State()
    monitor: Monitor = Monitor()
    realtime: Realtime = Realtime()
