"""Starts the node with a parameter file, its topics remapped to a camera's, and RViz if wanted."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

SHARE = FindPackageShare("boxgrasp_ros")
TOPICS = {  # of the node, and what a RealSense driver calls them by default
    "cloud": "/camera/camera/depth/color/points",
    "depth": "/camera/camera/aligned_depth_to_color/image_raw",
    "compressed_depth": "/camera/camera/aligned_depth_to_color/image_raw/compressedDepth",
    "camera_info": "/camera/camera/aligned_depth_to_color/camera_info",
    "color": "/camera/camera/color/image_raw",
    "robot_mask": "/robot_mask",
    "octomap": "/octomap_binary",
    "planning_scene": "/monitored_planning_scene",
}


def generate_launch_description() -> LaunchDescription:
    """The node with its arguments.

    Returns:
        What `ros2 launch boxgrasp_ros grasp_selector.launch.py` starts.
    """
    params = PathJoinSubstitution([SHARE, "config", "realsense.yaml"])
    rviz = PathJoinSubstitution([SHARE, "rviz", "boxgrasp.rviz"])
    arguments = [
        DeclareLaunchArgument("params_file", default_value=params, description="parameters"),
        DeclareLaunchArgument("use_sim_time", default_value="false", description="clock of /clock"),
        DeclareLaunchArgument("rviz", default_value="false", description="show RViz"),
        *(
            DeclareLaunchArgument(name, default_value=topic, description=f"topic of {name}")
            for name, topic in TOPICS.items()
        ),
    ]
    clock = {"use_sim_time": LaunchConfiguration("use_sim_time")}
    node = Node(
        package="boxgrasp_ros",
        executable="grasp_selector",
        name="grasp_selector",
        output="screen",
        parameters=[LaunchConfiguration("params_file"), clock],
        remappings=[(name, LaunchConfiguration(name)) for name in TOPICS],
    )
    shown = Node(
        package="rviz2",
        executable="rviz2",
        arguments=["-d", rviz],
        parameters=[clock],
        condition=IfCondition(LaunchConfiguration("rviz")),
    )
    return LaunchDescription([*arguments, node, shown])
