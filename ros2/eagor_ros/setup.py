"""Installs the launch file and the command `eagor_node`; `colcon build` calls this."""

from glob import glob

from setuptools import setup

NAME = "eagor_ros"

setup(
    name=NAME,
    version="0.0.0",
    packages=[],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", glob("launch/*.launch.py")),
    ],
    install_requires=["setuptools"],
    zip_safe=True,
    maintainer="The EAGOR developers",
    maintainer_email="eagor@example.org",
    description="A ROS 2 node that tracks the direction of a thing with a 360-degree camera",
    license="Apache-2.0",
)
