"""ROS 2 by one link: topics are sensors; goals, services and topics are actions; ROS sees how the robot does."""
