"""The daemon's recorder: MCAP files that repeat a run to the bit and open in the usual viewers.

| topic | encoding, schema | what |
| --- | --- | --- |
| `/raw/fog` | JSON | each piece read from the gyro's port (base64), with its arrival |
| `/raw/can` | JSON | each batch of CAN frames (data in base64), with the frames' stamps |
| `/raw/events` | JSON | other inputs of the estimate: ticks, ports lost and opened, commands |
| `/fog` | JSON | gyro samples: mean rate over an interval, before the calibration |
| `/wheels` | JSON | wheel samples: travel of both wheels over an interval |
| `/drd/pose` | JSON | the poses as published, every double exact; also each reason's `since_ns` |
| `/pose` | Protobuf, `foxglove.PoseInFrame` | the same for viewers; like the next two with `recording.viewers` only |
| `/tf` | Protobuf, `foxglove.FrameTransform` | the same as the transform from the odometry's frame to the robot's |
| `/scene` | Protobuf, `foxglove.SceneUpdate` | every 2 s: the path so far, thinned, and the 99 % bound as a disc |
| `/odom` | CDR, `nav_msgs/msg/Odometry` | the same as published for ROS 2 |
| `/health` | JSON | the health as published |
| `/findings` | JSON | the monitor's findings as published |

Attachments: `configuration.yaml` (as written), `configuration-in-force.yaml` (every key), and, if the configuration
names them, `calibration.yaml` and `encoders.dbc`. Metadata `drd`: version, run, part, robot, the clocks at the start,
flush and fsync intervals; `drd.end`: why the file ended, and what was lost. A file without `drd.end` was cut off.

`log_time` is when the recorder was handed the message, `publish_time` the data's own time: CLOCK_MONOTONIC, laid on
the wall clock once at the start, so neither ever steps (a clock that is set later shows in the payloads' `wall_ns`
only); payloads hold the monotonic nanoseconds. `sequence` numbers
all that is handed to the recorder: a hole in it is a loss, and within a file messages stand in that order.
`/raw/*` in the order of `sequence` through drd.pipeline.Pipeline repeats the run. A run whose file is full continues
in the next part; the estimate at a part's start is not in it, so a replay begins with the first part.
"""
