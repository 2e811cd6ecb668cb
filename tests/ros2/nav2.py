"""Actions of Nav2, which are not among rclpy's wheels: the names and types of their fields."""

NAVIGATE_TO_POSE = """\
geometry_msgs/PoseStamped pose
string behavior_tree
---
uint16 NONE=0
uint16 error_code
string error_msg
---
geometry_msgs/PoseStamped current_pose
builtin_interfaces/Duration navigation_time
builtin_interfaces/Duration estimated_time_remaining
int16 number_of_recoveries
float32 distance_remaining
"""

DOCK_ROBOT = """\
bool use_dock_id True
string dock_id
geometry_msgs/PoseStamped dock_pose
string dock_type
float32 max_staging_time 1000.0
bool navigate_to_staging_pose True
---
uint16 NONE=0
bool success True
uint16 error_code 0
uint16 num_retries 0
string error_msg
---
uint16 state
builtin_interfaces/Duration docking_time
uint16 num_retries 0
"""

DEFINITIONS = {"action/NavigateToPose.action": NAVIGATE_TO_POSE, "action/DockRobot.action": DOCK_ROBOT}
