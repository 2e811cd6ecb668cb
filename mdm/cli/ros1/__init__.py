"""``mdm import-ros1``: a package of the original MDM for ROS, as a TOML file."""
