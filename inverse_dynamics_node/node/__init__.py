"""The ROS 2 node: messages, parameters, services, life cycle and diagnostics."""
