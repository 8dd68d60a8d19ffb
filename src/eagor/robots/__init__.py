"""ROS 2 and the Go2 over DDS, the simulated Go2, and what keeps a robot safe while it follows an answer."""

__all__: list[str] = []
