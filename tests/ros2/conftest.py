"""What tests against the real ROS 2 need."""

from __future__ import annotations

import os

import pytest
from ros2.environment import generated, interpreter, once


@pytest.fixture(scope="session")
def shared_folder(tmp_path_factory):
    """Give a folder that is one for all workers of a run of the tests."""
    folder = tmp_path_factory.getbasetemp()
    return folder.parent if "PYTEST_XDIST_WORKER" in os.environ else folder


@pytest.fixture(scope="session")
def ros(shared_folder):
    """Give an interpreter that has rclpy; skip where it cannot be had."""
    return interpreter(shared_folder)


@pytest.fixture(scope="session")
def nav2(ros, shared_folder):
    """Give a folder with Nav2's messages, generated from their definitions; skip where they cannot be."""
    return once(shared_folder, "nav2", generated(ros))
