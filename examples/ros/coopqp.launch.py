"""ros2 launch coopqp.launch.py scenario:=my.yaml params:=params.yaml [use_sim_time:=true]."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.substitutions import LaunchConfiguration

ARGUMENTS = {
    "scenario": "scenario file, or the name of a shipped one",
    "params": "file of the node's parameters (docs/ros.md)",
}


def generate_launch_description() -> LaunchDescription:
    """The node as a process; when it ends, the launch goes on with what else it has started."""
    command = ["coopqp", "ros", LaunchConfiguration("scenario"), "--ros-args"]
    command += ["--params-file", LaunchConfiguration("params")]
    command += ["-p", ["use_sim_time:=", LaunchConfiguration("use_sim_time")]]
    return LaunchDescription([
        *(DeclareLaunchArgument(name, description=words) for name, words in ARGUMENTS.items()),
        DeclareLaunchArgument("use_sim_time", default_value="false", description="time of /clock"),
        ExecuteProcess(cmd=command, output="screen"),
    ])  # fmt: skip
