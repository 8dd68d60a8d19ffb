"""``ros2 launch eagor_ros eagor.launch.py query:="red chair"``."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

ARGUMENTS = {
    "query": ("", "what to look for"),
    "image_topic": ("", "the panoramas; empty: the only topic of pictures"),
    "odom_topic": ("", "the odometry; empty: the only one"),
    "perception": ("", "the detector"),
    "namespace": ("", "namespace of the node"),
    "use_sim_time": ("false", "take the time from /clock: in a simulation, or beside ros2 bag play --clock"),
}


def generate_launch_description():
    """The node with the parameters of config/params.yaml, and those that are given as arguments."""
    told = {name: LaunchConfiguration(name) for name in ARGUMENTS}
    defaults = PathJoinSubstitution([FindPackageShare("eagor_ros"), "config", "params.yaml"])
    params = LaunchConfiguration("params_file")
    text = {name: ParameterValue(told[name], value_type=str) for name in ("image_topic", "odom_topic", "perception")}
    sim_time = ParameterValue(told["use_sim_time"], value_type=bool)
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=value, description=what)
                for name, (value, what) in ARGUMENTS.items()
            ),
            DeclareLaunchArgument("params_file", default_value=defaults, description="a YAML file of parameters"),
            Node(
                package="eagor_ros",
                executable="node",
                name="eagor",
                namespace=told["namespace"],
                parameters=[params, {"queries": [told["query"]], "use_sim_time": sim_time, **text}],
                output="screen",
            ),
        ]
    )
