"""``ros2 launch eagor_ros eagor.launch.py queries:="red chair" image:=/x3/image odom:=/odom``."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.substitutions import LaunchConfiguration

REMAPPED = {"image": "image", "odom": "odom"}
PARAMETERS = {
    "queries": ("", "what to look for, with semicolons between"),
    "perception": ("", "the detector"),
    "image_transport": ("raw", "raw or compressed"),
    "pose_source": ("odom", "how the camera's motion is known"),
    "use_sim_time": ("false", "take the time from /clock"),
}


def generate_launch_description():
    """The command of the Python package, which is a lifecycle node that configures and activates itself."""
    command = ["eagor", "ros", "--ros-args", "-r", ["__ns:=/", LaunchConfiguration("namespace")]]
    for name in REMAPPED:
        command += ["-r", [f"{name}:=", LaunchConfiguration(name)]]
    for name in PARAMETERS:  # in quotes: a text without letters stays a text
        quote = "" if name == "use_sim_time" else "'"
        command += ["-p", [f"{name}:={quote}", LaunchConfiguration(name), quote]]
    declared = [DeclareLaunchArgument(name, default_value=value) for name, value in REMAPPED.items()]
    declared += [
        DeclareLaunchArgument(name, default_value=value, description=what) for name, (value, what) in PARAMETERS.items()
    ]
    declared.append(DeclareLaunchArgument("namespace", default_value=""))
    return LaunchDescription([*declared, ExecuteProcess(cmd=command, output="screen")])
