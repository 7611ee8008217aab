"""Starts the live node: `ros2 launch biodyn_ros biodyn.launch.py subject_file:=/path/to/subject.yaml`."""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import LifecycleNode
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

# Parameters of the node that are files or names: not parsed as YAML, so that a subject may have the name 1.
TEXTS = {
    "subject_file": "path of a subject file, or the name of a bundled subject",
    "limits_file": "path of a file with action and limit values; empty: those of 2002/44/EC",
}
# Parameters of the node that are numbers or booleans.
VALUES = {
    "autostart": "configure and activate at start",
    "publish_measured": "publish the conditioned measurements too",
    "yaw_deg": "angle from the vehicle's forward direction to the seat sensor's first axis [deg]",
    "use_sim_time": "follow /clock",
}


def live_node(context: LaunchContext) -> list[LifecycleNode]:
    """The node, with the parameter file, overridden by the given arguments."""
    given = {name: LaunchConfiguration(name).perform(context) for name in (*TEXTS, *VALUES)}
    texts = {name: ParameterValue(given[name], value_type=str) for name in TEXTS if given[name]}
    values = {name: given[name] for name in VALUES if given[name]}
    return [
        LifecycleNode(
            package="biodyn_ros",
            executable="biodyn_live",
            name="biodyn",
            namespace=LaunchConfiguration("namespace"),
            parameters=[LaunchConfiguration("params_file"), {**texts, **values}],
            output="screen",
        )
    ]


def generate_launch_description() -> LaunchDescription:
    """The arguments and the node; an empty argument keeps the value of the parameter file."""
    params_file = PathJoinSubstitution([FindPackageShare("biodyn_ros"), "config", "live.yaml"])
    arguments = [
        DeclareLaunchArgument(name, default_value="", description=text) for name, text in {**TEXTS, **VALUES}.items()
    ]
    return LaunchDescription(
        [
            DeclareLaunchArgument("params_file", default_value=params_file, description="Parameters of the node"),
            DeclareLaunchArgument("namespace", default_value="", description="Namespace of the node and its topics"),
            *arguments,
            OpaqueFunction(function=live_node),
        ]
    )
