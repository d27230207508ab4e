"""Every configuration key of the daemon: type, unit, range, default and when to change it."""

from dataclasses import dataclass, replace
from pathlib import Path

from drd.schema import REQUIRED, key, section


@dataclass(frozen=True, kw_only=True)
class Robot:
    """The robot's geometry as its engineers believe it."""

    name: str = key("robot", "Name of the robot, shown in health and logs")
    wheel_radius_m: float = key(REQUIRED, "Rolling radius of the wheels under load", "m", low=0.005, high=5)
    left_scale: float = key(
        1.0,
        "Factor on the left wheel's travel (UMBmark's c_l); change after a calibration",
        low=0.5,
        high=1.5,
    )
    right_scale: float = key(
        1.0,
        "Factor on the right wheel's travel (UMBmark's c_r); change after a calibration",
        low=0.5,
        high=1.5,
    )
    tread_m: float = key(
        REQUIRED,
        "Effective distance between left and right wheels; a skid-steer robot's is 1.0 to 1.9 times the measured one",
        "m",
        low=0.02,
        high=20,
    )
    drive: str = key(
        "auto",
        "How it steers: differential = two wheels and casters; skid = wheels slip sideways in each turn (four wheels, "
        "tracks); auto = differential, until the gyro shows an effective tread that is not the stated one",
        choices=("auto", "differential", "skid"),
    )
    max_speed_m_s: float = key(
        3.0,
        "Faster wheel travel is a counter jump, not motion; set to 1.5 times the robot's top speed",
        "m/s",
        low=0.01,
        high=100,
    )
    max_acceleration_deg_s2: float = key(
        500.0,
        "A gyro reading that asks for more is a corrupted one; lower it to the robot's ability",
        "deg/s^2",
        low=10,
        high=1e6,
    )


@dataclass(frozen=True, kw_only=True)
class Ecore:
    """Profile of the E-Core's payload bytes m1 to m4. No manual is public: this is an assumption, change it."""

    status_byte: int = key(1, "Payload byte that holds the status bits; 0 = none", low=0, high=4)
    status_mask: int = key(0, "Status bits that are looked at; 0 = never reported invalid", low=0, high=255)
    status_good: int = key(0, "Value of the masked status bits when the reading is valid", low=0, high=255)
    temperature_byte: int = key(3, "First payload byte of the big-endian int16 temperature; 0 = none", low=0, high=3)
    temperature_scale_c: float = key(0.01, "Temperature of one count", "degC", low=1e-6, high=10)
    temperature_offset_c: float = key(0.0, "Temperature at count zero", "degC", low=-300, high=300)


@dataclass(frozen=True, kw_only=True)
class Dsp3000:
    """KVH DSP-3000, ASCII lines."""

    mode: str = key(
        "rate",
        "What word 1 of a line is, as set in the gyro: rate (R), incremental angle (A) or integrated angle (P)",
        choices=("rate", "incremental", "integrated"),
    )


@dataclass(frozen=True, kw_only=True)
class Dsp17xx:
    """KVH DSP-1760, 1725, 1750 and 1775, 36-byte binary format A."""

    rotation: str = key("delta", "What the gyro is set to send (=rotfmt)", choices=("delta", "rate"))
    angle_unit: str = key("radians", "Unit the gyro is set to send (=rotunits)", choices=("radians", "degrees"))
    temperature_scale_c: float = key(
        1.0, "Temperature of one count: 1, or 0.01 after =tempunits,C_100", "degC", low=0.001, high=10
    )


@dataclass(frozen=True, kw_only=True)
class Fog:
    """The fibre-optic gyro and its serial port."""

    protocol: str = key(
        "ecore",
        "What the gyro speaks; none = the robot has no gyro",
        choices=("ecore", "dsp3000", "dsp17xx", "none"),
    )
    port: str = key("/dev/fog", "Serial device; prefer a stable name from udev", "path")
    baud: int = key(9600, "Line speed", "bit/s", low=300, high=4_147_200)
    rate_hz: float = key(10.0, "Nominal output rate; the true rate is measured", "Hz", low=0.5, high=2000)
    full_scale_deg_s: float = key(
        100.0,
        "Largest rate the gyro can report; readings beyond 99.9 % of it are over-range. Scales the E-Core's counts",
        "deg/s",
        low=1,
        high=5000,
    )
    positive: str = key(
        "clockwise",
        "Turn that the gyro reports as positive, seen from above; KVH gyros count "
        "clockwise. counterclockwise when mounted upside down",
        choices=("clockwise", "counterclockwise"),
    )
    axis: str = key("z", "Sensor axis that points up; single-axis gyros have only z", choices=("x", "y", "z"))
    latency_s: float = key(
        0.0,
        "Time from the end of a measuring interval to the arrival of its packet's last byte: the gyro's filter delay "
        "and the transmission",
        "s",
        low=0,
        high=1,
    )
    silent_after_s: float = key(0.5, "Silence that makes the health say so", "s", low=0.01, high=60)
    low_latency: bool = key(True, "Ask the serial driver for low latency; change only if the driver misbehaves")
    ecore: Ecore = section(Ecore)
    dsp3000: Dsp3000 = section(Dsp3000)
    dsp17xx: Dsp17xx = section(Dsp17xx)


@dataclass(frozen=True, kw_only=True)
class Wheel:
    """One side: where its counter is on the bus."""

    node: int = key(1, "Node or controller id on the bus (cia406, odrive, vesc)", low=0, high=255)
    reversed: bool = key(False, "True when the counter falls while the robot drives forward")
    message: str | None = key(None, "DBC message that holds this side's signal (dbc)")
    signal: str | None = key(None, "DBC signal with this side's counts or speed (dbc)")


@dataclass(frozen=True, kw_only=True)
class Left(Wheel):
    """The left wheel's counter."""


@dataclass(frozen=True, kw_only=True)
class Right(Wheel):
    """The right wheel's counter."""

    node: int = key(2, "Node or controller id on the bus (cia406, odrive, vesc)", low=0, high=255)


@dataclass(frozen=True, kw_only=True)
class Cia406:
    """CANopen encoders, one node per wheel."""

    tpdo: int = key(1, "Which TPDO carries the position (object 6004h)", low=1, high=4)
    byte_offset: int = key(0, "First byte of the position in that TPDO", low=0, high=7)
    byte_length: int = key(4, "Bytes of the position, little-endian unsigned", "bytes", low=1, high=8)
    sync_period_s: float | None = key(
        None,
        "Send SYNC this often, so that both wheels are sampled together (TPDO2, synchronous); null = listen only",
        "s",
        low=0.001,
        high=10,
    )
    start_nodes: bool = key(
        False,
        "Send NMT start to both nodes at opening and after a node's boot-up message; "
        "true where no other master does it",
    )


@dataclass(frozen=True, kw_only=True)
class Odrive:
    """ODrive CAN Simple."""

    message: str = key(
        "estimates",
        "Cyclic message to read: estimates (0x009, float revolutions) or counts (0x00A, "
        "firmware up to 0.5.6; finer over long distances)",
        choices=("estimates", "counts"),
    )


@dataclass(frozen=True, kw_only=True)
class Vesc:
    """VESC STATUS_5 tachometer."""

    pole_pairs: int = key(7, "Pole pairs of the motor: 6 tachometer counts per pair and motor turn", low=1, high=100)
    gear_ratio: float = key(1.0, "Motor turns per wheel turn", low=0.01, high=1000)


@dataclass(frozen=True, kw_only=True)
class Dbc:
    """Any other layout, described by a DBC file (needs the extra drd[dbc])."""

    file: str | None = key(None, "DBC file, relative to this configuration", "path")
    quantity: str = key(
        "counts", "What the two signals are: counts, or speed at the wheel's rim", choices=("counts", "speed")
    )
    speed_unit_m_s: float = key(1.0, "One unit of the speed signal; 0.277778 for km/h", "m/s", low=1e-6, high=100)


@dataclass(frozen=True, kw_only=True)
class Encoders:
    """The wheel encoders and their CAN interface."""

    layout: str = key("cia406", "How the frames are laid out", choices=("cia406", "agilex", "odrive", "vesc", "dbc"))
    interface: str = key("socketcan", "python-can interface: socketcan on robots, slcan for a serial adapter")
    channel: str = key("can0", "Interface name, or the serial device of an slcan adapter")
    bitrate: int | None = key(
        None,
        "Bus speed, set by slcan and vendor adapters; socketcan's is set by the system",
        "bit/s",
        low=10_000,
        high=1_000_000,
    )
    open_delay_s: float = key(
        0.0, "Wait after opening an slcan adapter; 2 for Arduino-like ones that restart", "s", low=0, high=10
    )
    counts_per_revolution: float | None = key(
        None,
        "Counts per wheel turn (cia406, odrive counts, dbc counts), gear included; the other layouts know theirs",
        "counts",
        low=1,
        high=1e9,
    )
    modulus_counts: int | None = key(
        None,
        "Count at which the counter starts again at zero (cia406: object 6002h, or 2^bits); null = the layout's own",
        "counts",
        low=4,
        high=2**64,
    )
    rate_hz: float = key(20.0, "Nominal rate of the counters", "Hz", low=1, high=1000)
    latency_s: float = key(0.0, "Time from the sampling of a counter to its frame on the bus", "s", low=0, high=1)
    pair_window_s: float = key(
        0.04, "Left and right readings further apart than this are not paired", "s", low=0.0005, high=1
    )
    gap_s: float = key(0.5, "After a longer gap the first counts are a new start, not motion", "s", low=0.02, high=10)
    silent_after_s: float = key(0.3, "Silence that makes the health say so", "s", low=0.02, high=60)
    queue_frames: int = key(
        1024,
        "Frames kept while the estimator is busy; more are dropped and counted",
        "frames",
        low=16,
        high=1_000_000,
    )
    left: Left = section(Left)
    right: Right = section(Right)
    cia406: Cia406 = section(Cia406)
    odrive: Odrive = section(Odrive)
    vesc: Vesc = section(Vesc)
    dbc: Dbc = section(Dbc)


@dataclass(frozen=True, kw_only=True)
class StaticBias:
    """The gyro's bias, measured while the robot stands before a mission."""

    duration_s: float = key(
        10.0,
        "Standstill that is averaged; 0 skips it. 10 s leaves 1.6 deg/h (RD2100 class)",
        "s",
        low=0,
        high=600,
    )
    minimum_s: float = key(
        5.0,
        "Shorter standstills, cut by motion, are not used; the bias then starts from zero with the data sheet's spread",
        "s",
        low=0.1,
        high=600,
    )


@dataclass(frozen=True, kw_only=True)
class Initial:
    """Standard deviations at the start."""

    position_m: float = key(0.0, "Start position", "m", low=0, high=1e6)
    heading_deg: float = key(0.0, "Start heading", "deg", low=0, high=180)
    wheel_scale: float | None = key(
        None, "Wheel radii against their nominal, each; null = 0.005, and 0.04 for skid steering", "1", low=0, high=0.5
    )
    tread: float | None = key(
        None,
        "Tread against its nominal; null = 0.02 as measured by tape, and 0.5 where a gyro can tell an effective one",
        "1",
        low=0,
        high=1,
    )
    gyro_scale: float = key(0.005, "Gyro scale factor, where it is estimated", "1", low=0, high=0.5)
    wheel_lag_s: float = key(
        0.2, "Lag of the wheels' samples behind the gyro's, beyond the stated latencies; 0 = none", "s", low=0, high=1
    )
    slip_s: float | None = key(
        None,
        "Sideways slip: the body's speed to its side over speed times yaw rate; null = 0, and 0.25 for skid steering",
        "s",
        low=0,
        high=5,
    )
    gyro_bias_deg_s: float = key(
        0.02, "Gyro bias when no standstill was measured (bias repeatability)", "deg/s", low=0, high=10
    )


@dataclass(frozen=True, kw_only=True)
class Noise:
    """The physical noise profile, in data-sheet units."""

    wheel_m_per_sqrt_m: float = key(
        0.002,
        "Each wheel's travel noise: slip, bumps; 0.0005 indoors, 0.005 off-road",
        "m/sqrt(m)",
        low=0,
        high=1,
    )
    lateral_m_per_sqrt_m: float = key(0.001, "Sideways drift on straight ground", "m/sqrt(m)", low=0, high=1)
    turn_rad_per_sqrt_rad: float = key(
        0.02,
        "Heading noise of the wheels when turning: 0.005 for two driven wheels, 0.05 or more for skid-steer",
        "rad/sqrt(rad)",
        low=0,
        high=1,
    )
    turn_m_per_sqrt_rad: float = key(
        0.005, "Position noise when turning (the centre of rotation wanders)", "m/sqrt(rad)", low=0, high=1
    )
    wheel_scale_per_sqrt_m: float = key(
        2e-5, "Slow change of each wheel's scale: tyre, load", "1/sqrt(m)", low=0, high=0.1
    )
    tread_per_sqrt_rad: float = key(
        0.002,
        "Change of the tread (relative) while turning: ground changes; 0.01 for skid-steer",
        "1/sqrt(rad)",
        low=0,
        high=1,
    )
    gyro_deg_per_sqrt_h: float = key(0.083, "Angle random walk of the gyro", "deg/sqrt(h)", low=0, high=100)
    gyro_bias_deg_h_per_sqrt_h: float = key(3.7, "Rate random walk of the gyro", "deg/h/sqrt(h)", low=0, high=1e4)
    gyro_bias_repeatability_deg_s: float = key(
        0.002,
        "Change of the gyro's bias when it is switched off and on; added after each silence of the gyro",
        "deg/s",
        low=0,
        high=10,
    )
    gyro_scale_per_sqrt_h: float = key(
        2e-4, "Slow change of the gyro's scale, where it is estimated", "1/sqrt(h)", low=0, high=1
    )
    comparison_deg: float = key(
        0.02,
        "Floor of the comparison of the two headings: encoder and gyro resolution",
        "deg",
        low=1e-6,
        high=10,
    )
    timing_s: float = key(0.002, "Uncertainty of the gyro's time against the encoders'", "s", low=0, high=1)


@dataclass(frozen=True, kw_only=True)
class Estimation:
    """Odometry and the indirect feedback Kalman filter."""

    heading: str = key(
        "filter",
        "Where the heading comes from: filter = gyro and wheels, compared by the Kalman filter; gyro = the gyro alone, "
        "the wheels only measure the way (the paper's runs without filter). Change it where the wheels skid so much "
        "that their turning says nothing",
        choices=("filter", "gyro"),
    )
    profile: str = key(
        "physical",
        "Noise: physical (per metre, radian and second) or paper (its printed Q and R)",
        choices=("physical", "paper"),
    )
    gyro_scale: str = key(
        "auto",
        "Estimate the gyro's scale: auto = unless a calibration is loaded (as the paper does)",
        choices=("auto", "yes", "no"),
    )
    midpoint: bool = key(True, "Advance along the heading in the middle of a step; false = equation 7 as printed")
    gate_sigma: float = key(5.0, "Disagreement of gyro and wheels that is rejected", "sigma", low=1, high=100)
    rejections_before_release: int = key(
        3,
        "Rejections in a row after which the wheels' heading is taken for slip and follows the gyro",
        low=1,
        high=1000,
    )
    invalid_after_s: float = key(
        10.0, "Silence of the encoders after which the pose is invalid", "s", low=0.1, high=3600
    )
    max_position_bound_m: float | None = key(
        None, "Position bound beyond which the pose is invalid; null = never", "m", low=0.001, high=1e6
    )
    reorder_s: float = key(
        0.25,
        "How long one sensor waits for the other before the estimate goes on without it",
        "s",
        low=0.01,
        high=5,
    )
    static_bias: StaticBias = section(StaticBias)
    initial: Initial = section(Initial)
    noise: Noise = section(Noise)


@dataclass(frozen=True, kw_only=True)
class CalibrationFile:
    """The gyro's stored calibration."""

    file: str | None = key(
        None,
        "Calibration file (temperature-varying cubic), relative to this configuration; null = none",
        "path",
    )


@dataclass(frozen=True, kw_only=True)
class ModelFile:
    """Physical effects beyond the nominal robot, which are taken off the samples."""

    file: str | None = key(
        None,
        "Model file (effects of drd's catalogue with their parameters), relative to this configuration; null = none",
        "path",
    )


@dataclass(frozen=True, kw_only=True)
class Output:
    """Zenoh: where the pose is published."""

    prefix: str = key("drd", "Prefix of all keys")
    frame_id: str = key("odom", "Frame of the pose in odom messages")
    child_frame_id: str = key("base_link", "Frame of the robot in odom messages")
    publish_on: str = key(
        "wheels",
        "Samples that publish a pose: wheels, or gyro (at most at the encoders' rate)",
        choices=("wheels", "gyro"),
    )
    health_period_s: float = key(1.0, "How often the health is published", "s", low=0.1, high=60)
    listen: tuple[str, ...] = key(
        ("tcp/127.0.0.1:7447",),
        "Zenoh end points to listen on; the default is reached from this machine only",
        "Zenoh end points",
    )
    connect: tuple[str, ...] = key((), "Zenoh end points to connect to, such as a router", "Zenoh end points")
    zenoh_config: str | None = key(
        None,
        "Zenoh's own configuration file (JSON5), relative to this one; listen and connect are then not looked at. "
        "zenoh-tls.json5 is one with certificates and access control",
        "path",
    )
    commands: bool = key(
        False,
        "Allow set_pose, reset and calibrate_bias over Zenoh, to whoever reaches an end point or, with zenoh_config, "
        "to whom its access_control allows it; each one is logged",
    )
    ros2: bool = key(
        False,
        "Publish nav_msgs/Odometry for ROS 2 (rmw_zenoh) too; connect to its router, "
        "tcp/localhost:7447, and change listen",
    )
    ros2_domain: int = key(0, "ROS_DOMAIN_ID", low=0, high=232)
    ros2_topic: str = key("odom", "ROS 2 topic, namespace included")
    ros2_hash: bool = key(True, "Type hash in the key (Iron and later); false for Humble")

    def beside(self, folder: Path) -> "Output":
        """The same with its file found from `folder`, where the configuration lies."""
        return self if self.zenoh_config is None else replace(self, zenoh_config=str(folder / self.zenoh_config))


@dataclass(frozen=True, kw_only=True)
class Recording:
    """MCAP files with all that came in and went out, for replay and viewers."""

    enabled: bool = key(False, "Record every run of the daemon: some 40 MB an hour at 20 poses a second")
    folder: str = key(
        "recordings",
        "Where the files go; relative to the service's state directory (/var/lib/drd-NAME) under systemd, else to the "
        "working directory",
        "path",
    )
    flush_s: float = key(
        1.0, "How often data is handed to the system: what a killed daemon loses", "s", low=0.1, high=60
    )
    fsync_s: float = key(
        5.0, "How often the disk is waited for: what a power cut loses; longer spares flash", "s", low=0.1, high=3600
    )
    max_file_mb: float = key(64.0, "A larger file is continued in a new one", "MB", low=1, high=100_000)
    max_file_age_s: float = key(3600.0, "An older file is continued in a new one", "s", low=10, high=1e6)
    max_total_mb: float = key(
        2000.0, "The oldest files of this robot are deleted beyond this", "MB", low=2, high=10_000_000
    )


@dataclass(frozen=True, kw_only=True)
class State:
    """What the daemon remembers over a restart, and how much of it is believed then."""

    enabled: bool = key(True, "Keep the state, and go on from it at the start")
    folder: str | None = key(
        None,
        "Where the file lies; relative to the service's state directory (/var/lib/drd-NAME) under systemd, else to the "
        "working directory. null = that directory under systemd, else no state is kept",
        "path",
    )
    period_s: float = key(
        5.0,
        "How often it is written, beside each time that the robot starts to move or drd ends; longer spares flash, and "
        "leaves more unseen way when drd is killed on the move",
        "s",
        low=0.5,
        high=3600,
    )
    pose: str = key(
        "continue",
        "Where the robot is at the start: continue = where it was, origin = back at the origin with the uncertainty of "
        "estimation.initial, for robots that restart at their dock; what was learned is kept either way",
        choices=("continue", "origin"),
    )
    believed_s: float = key(
        600.0,
        "After a longer time off, or one that no clock tells, somebody may have carried the robot: the pose goes on, "
        "but is degraded until set_pose or reset. Longer where nobody can",
        "s",
        low=0,
        high=1e9,
    )
    position_m: float = key(
        0.2,
        "How far a robot that stands may have been pushed while drd was off, standard deviation of each coordinate; 0 "
        "for one that is braked",
        "m",
        low=0,
        high=1e4,
    )
    heading_deg: float = key(
        5.0,
        "How far it may have been turned meanwhile, standard deviation; 0 for one that is braked",
        "deg",
        low=0,
        high=180,
    )
    wheel_scale: float = key(
        5e-4, "How much each wheel's radius may have changed meanwhile: load, tyres, temperature", "1", low=0, high=0.5
    )
    tread: float = key(
        0.005, "How much the tread may have changed meanwhile: another ground; 0.05 for skid-steer", "1", low=0, high=1
    )


@dataclass(frozen=True, kw_only=True)
class Realtime:
    """Scheduling; each is refused with a message, not an error, where the system does not permit it."""

    freeze_gc: bool = key(True, "Freeze start-up objects out of garbage collection")
    lock_memory: bool = key(False, "Lock all memory (mlockall); needs LimitMEMLOCK")
    fifo_priority: int = key(0, "SCHED_FIFO priority; 0 = normal scheduling. Needs LimitRTPRIO", low=0, high=99)


@dataclass(frozen=True, kw_only=True)
class Config:
    """The whole configuration file."""

    robot: Robot = section(Robot)
    fog: Fog = section(Fog)
    encoders: Encoders = section(Encoders)
    calibration: CalibrationFile = section(CalibrationFile)
    model: ModelFile = section(ModelFile)
    estimation: Estimation = section(Estimation)
    output: Output = section(Output)
    recording: Recording = section(Recording)
    state: State = section(State)
    realtime: Realtime = section(Realtime)
