"""What all tests share."""

import os

# The tests run side by side: threads that wait for each other must not spin on cores that others need.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
