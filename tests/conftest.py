"""What all tests share."""

import os

# The tests run side by side: threads that wait for each other must not spin on cores that others need.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")


def pytest_xdist_auto_num_workers() -> int:
    """One more than there are cores: many tests wait for servers, browsers and processes of their own."""
    return (os.cpu_count() or 1) + 1
