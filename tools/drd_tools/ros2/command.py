"""`drd ros2`: a ROS 2 node that publishes the output of a running drd."""

import argparse
import importlib
import sys
from typing import Any, Final

import zenoh

from drd.commands import command
from drd.output.session import tidy

DESCRIPTION: Final = """\
A ROS 2 node for any middleware other than rmw_zenoh: it listens to a running drd over Zenoh and publishes odometry, the
transform between its frames, an Imu and diagnostics. The services reset and set_pose (the latter where
robot_localization is installed) and the topic set_pose are passed on to drd. Ctrl-C ends it. For rmw_zenoh no node is
needed: set output.ros2.

rclpy comes with ROS 2: source its setup.bash. Where no ROS 2 is installed, the extra drd[ros2] has it as wheels. They
need a virtual environment of their own: each Python process in it is started a second time.

parameters:
  connect          Zenoh endpoint of drd, one of its output.listen (tcp/127.0.0.1:7447)
  zenoh_config     Zenoh configuration file instead, e.g. for certificates
  prefix           output.prefix of that drd (drd)
  frame_id         frame of the pose (empty: drd's output.frame_id)
  child_frame_id   frame of the robot (empty: drd's output.child_frame_id)
  topics.odom, topics.tf, topics.imu, topics.diagnostics
                   (odom, /tf, imu, /diagnostics; empty: not published)
"""
EPILOG: Final = """\
examples:
  drd ros2
  drd ros2 --ros-args -p connect:=tcp/192.168.1.10:7447 -r __ns:=/robot1 -p frame_id:=robot1/odom
  drd ros2 --ros-args -p topics.tf:="''"        robot_localization publishes the transform

Exit code: 0 ended, 1 Zenoh cannot be opened, 2 bad usage, or rclpy is missing.
"""


def main(argv: list[str]) -> int:
    """Spin until Ctrl-C. Returns the exit code."""
    arguments = _parser().parse_args(argv)
    rclpy = _rclpy()
    if rclpy is None:
        return 2
    node_module = importlib.import_module("drd_tools.ros2.node")
    try:
        rclpy.init(args=["drd", *(["--ros-args", *arguments.ros_args] if arguments.ros_args else [])])
        node = node_module.DrdNode()
    except node_module.BAD_ARGUMENTS as error:
        print(f"drd ros2: {str(error).partition(chr(10))[0]}", file=sys.stderr)
        return 2
    try:
        node.connect()
        rclpy.spin(node)
    except zenoh.ZError as error:
        print(f"drd ros2: {tidy(error)}", file=sys.stderr)
        return 1
    except (KeyboardInterrupt, node_module.ExternalShutdownException):
        return 0
    finally:
        node.close()
        rclpy.try_shutdown()
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = command("drd ros2", DESCRIPTION, EPILOG)
    text = "what any node of ROS 2 takes: parameters, remappings, its namespace"
    parser.add_argument("--ros-args", nargs=argparse.REMAINDER, default=[], metavar="...", help=text)
    return parser


def _rclpy() -> Any:
    """Import the package; return None, after printing how to get it, if it cannot be loaded."""
    try:
        return importlib.import_module("rclpy")
    except ImportError as error:  # its libraries may be missing, too
        text = "source the setup.bash of your ROS 2, or install the extra drd[ros2] in an environment of its own"
        print(f"drd ros2: rclpy cannot be loaded ({error}): {text}", file=sys.stderr)
        return None
