"""Plays a bag to the live node and serves its page: `ros2 launch biodyn_ros replay_bag.launch.py bag:=drive.mcap`."""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import LifecycleNode
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import ExecutableInPackage, FindPackageShare

# Arguments with their defaults; the bag is required.
ARGUMENTS = {
    "bag": (None, "The recording: a .mcap or .db3 file, or the directory of a bag"),
    "subject_file": ("subject_1", "path of a subject file, or the name of a bundled subject"),
    "rate": ("1.0", "Speed, as a multiple of recorded time"),
    "loop": ("false", "Start the bag again at its end"),
}


def player_and_node(context: LaunchContext) -> list[ExecuteProcess | LifecycleNode]:
    """The player, which waits for its subscribers, and the node, which continues after the end of the bag."""
    given = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    # No Node action, because it adds --ros-args, which `biodyn play` does not accept.
    biodyn = ExecutableInPackage(package="biodyn_ros", executable="biodyn")
    options = ["--rate", given["rate"], *(["--loop"] if given["loop"].lower() == "true" else [])]
    parameters = {
        # A name that looks like a number must reach the node as text.
        "subject_file": ParameterValue(given["subject_file"], value_type=str),
        "dashboard": True,
        "publish_measured": True,
        # The exposure of a replayed recording is not stored.
        "state_file": "none",
    }
    return [
        ExecuteProcess(cmd=[biodyn, "play", given["bag"], *options], output="screen"),
        LifecycleNode(
            package="biodyn_ros",
            executable="biodyn_live",
            name="biodyn",
            namespace="",
            parameters=[PathJoinSubstitution([FindPackageShare("biodyn_ros"), "config", "live.yaml"]), parameters],
            output="screen",
        ),
    ]


def generate_launch_description() -> LaunchDescription:
    """The arguments and both processes."""
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, description=text, **({} if default is None else {"default_value": default}))
                for name, (default, text) in ARGUMENTS.items()
            ),
            OpaqueFunction(function=player_and_node),
        ]
    )
