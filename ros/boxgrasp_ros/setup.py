"""Installs the node, its launch file, parameters and RViz configuration."""

from glob import glob

from setuptools import setup

NAME = "boxgrasp_ros"

setup(
    name=NAME,
    version="0.1.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/config", glob("config/*.yaml")),
        (f"share/{NAME}/launch", glob("launch/*.launch.py")),
        (f"share/{NAME}/rviz", glob("rviz/*.rviz")),
    ],
    install_requires=["setuptools"],
    maintainer="boxgrasp contributors",
    maintainer_email="maintainers@boxgrasp.invalid",
    description="A node that answers a depth view with a checked gripper pose, or asks for help.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            f"grasp_selector = {NAME}.grasp_selector:main",
            f"replay = {NAME}.replay:main",
        ]
    },
)
