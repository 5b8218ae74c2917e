"""The programs that labs already use, each on a `hil.Mover`: Micro-Manager, Bluesky, ROS 2.

Each module needs one foreign package, which is imported nowhere else, and says what to install where it is missing.
"""
